/** Fields that every calibration request has. */
import type { Body } from '../../api/client';

type Common = 'profile' | 'name' | 'note';
type Requests = Extract<Body<'/api/calibrations'>, { kind: `bench-${string}` }>;
/** Each member of a union type without the keys. */
type Without<T, K extends PropertyKey> = T extends unknown ? Omit<T, K> : never;
export type Bench = Without<Requests, Common>;
