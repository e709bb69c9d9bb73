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
