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
