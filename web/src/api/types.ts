/** Short names for the shapes of the HTTP contract; the shapes themselves are generated from openapi.json (`npm run types`). */
import type { components } from './schema';

type S = components['schemas'];
export type Link = S['LinkOut'];
export type Direction = S['DirectionOut'];
export type Bank = S['BankOut'];
export type Alarm = S['AlarmOut'];
export type Dictionary = S['DictionaryOut'];
export type CommandDefinition = S['CommandDefinitionOut'];
export type Argument = S['ArgumentOut'];
export type FieldDefinition = S['FieldDefinitionOut'];
export type Precondition = S['PreconditionOut'];
export type Check = S['CheckOut'];
export type Command = S['CommandOut'];
export type Stage = S['StageOut'];
export type ByteGroup = S['ByteGroupOut'];
export type Value = S['ValueOut'];
export type Latest = S['LatestOut'];
export type History = S['HistoryOut'];
export type Cycle = S['CycleOut'];
export type Frame = S['FrameOut'];
export type FramePage = S['FramePage'];
export type FrameDetail = S['FrameDetailOut'];
export type Solution = S['SolutionOut'];
export type SolutionDetail = S['SolutionDetailOut'];
export type Star = S['StarOut'];
export type Predicted = S['PredictedOut'];
export type Region = S['RegionOut'];
export type Comparison = S['ComparisonOut'];
export type FrameReplay = S['FrameReplayOut'];
export type Attitude = S['AttitudeOut'];
export type SolveIn = S['SolveIn'];
export type Histogram = S['HistogramOut'];
export type Transfer = S['TransferOut'];
export type Job = S['JobOut'];
export type EventRow = S['EventOut'];
export type Contact = S['ContactOut'];
export type Authority = S['AuthorityOut'];
export type AlarmRow = S['AlarmRow'];
export type Stack = S['StackOut'];
export type StackIn = S['StackIn'];
export type Step = S['StepOut'];
export type StackCheck = S['StackCheckOut'];
export type StackRun = S['StackRunOut'];
export type Schedule = S['ScheduleOut'];
export type ScheduleCheck = S['ScheduleCheckOut'];
export type Limits = S['LimitsOut'];
export type Limit = S['LimitOut'];
export type ContactDetail = S['ContactDetailOut'];
export type Replay = S['ReplayOut'];
export type Table = S['TableOut'];
export type TableDetail = S['TableDetailOut'];
export type OnBoardTable = S['OnBoardTableOut'];
export type ExperimentEntry = S['ExperimentOut'];
export type ChainRecord = S['ChainRecordOut'];
export type DesignIn = S['DesignIn'];
export type Design = S['DesignOut'];
export type DesignCameras = S['DesignCamerasOut'];
export type DesignFigure = S['DesignFigureOut'];
export type DesignCurve = S['CurveOut'];
export type DesignBaffle = S['BaffleOut'];
export type DesignRow = S['TradeRowOut'];
export type FieldCount = S['FieldCountOut'];
export type Sky = S['SkyOut'];
export type Profile = S['ProfileOut'];
export type CatalogueIn = S['CatalogueIn'];
export type Catalogue = S['CatalogueOut'];
export type CatalogueDetail = S['CatalogueDetailOut'];
export type Preview = S['PreviewOut'];
export type Envelope = S['EnvelopeOut'];
export type SkyStar = S['SkyStarOut'];
export type Funnel = S['FunnelOut'];
export type Quality = S['QualityOut'];
export type Ambiguity = S['AmbiguityOut'];
export type Lifetime = S['LifetimeOut'];
export type Wanderer = S['WandererOut'];
export type CatalogueDiff = S['CatalogueDiffOut'];
export type ChangedStar = S['ChangedStarOut'];
export type Timeline = S['TimelineOut'];
export type BankStay = S['BankStayOut'];
export type StarList = S['StarListOut'];

export interface Problem {
  id: string;
  message: string;
  expected: string;
  got: string;
  hint: string;
}
export type ArgumentValue = number | string | boolean;
/** What a job of experiments leaves in its result. */
export interface ExperimentRecord {
  name: string;
  title: string;
  source: string;
  columns: string[];
  rows: (string | number | null)[][];
  conditions: string[];
  seed: number;
  notes: string[];
  series: { title: string; x_label: string; y_label: string; x: number[]; y: number[] }[];
}
export type CalibrationRow = S['CalibrationOut'];
export type CalibrationDetail = S['CalibrationDetailOut'];
export type CalibrationDiff = S['CalibrationDiffOut'];
export type AnalysisRow = S['AnalysisOut'];
export type AnalysisDetail = S['AnalysisDetailOut'];
export type ReportView = S['ReportViewOut'];
export type ReportPlot = S['PlotOut'];
export type ReportArrows = S['ArrowsOut'];
export type ReportCells = S['CellsOut'];
export type ReportPicture = S['PictureOut'];

/** Who is signed in, as GET /api/session tells. */
export interface SessionInfo { signed_in: boolean; name: string; role: string; permissions: string[]; csrf: string; expires: string | null; set_up_needed: boolean; must_change: boolean }
