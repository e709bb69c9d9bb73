/** A request of a bench method without the fields that every calibration has. */
import type { Body } from '../../api/client';

type Common = 'profile' | 'name' | 'note';
type Requests = Extract<Body<'/api/calibrations'>, { kind: `bench-${string}` }>;
/** For a union type: each member without the keys. */
type Without<T, K extends PropertyKey> = T extends unknown ? Omit<T, K> : never;
export type Bench = Without<Requests, Common>;
