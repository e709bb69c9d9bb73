/** What an admin asks and changes; apart from client.ts, so that it is fetched with the page only. */
import { get, post, query, send } from './client';
import type { components } from './schema';
import type { Job } from './types';

type S = components['schemas'];
export type UserRow = S['UserOut'];
export type OneTimeLink = S['LinkedUserOut'];
export type SessionRow = S['SignInOut'];
export type TokenRow = S['TokenOut'];
export type AuditRow = S['AuditRowOut'];
export type AuditVerdict = S['AuditVerdictOut'];
export type Health = S['HealthOut'];
export type Backup = S['BackupOut'];
export type Policy = S['RetentionIn'];
export type Retention = S['RetentionOut'];
/** What a policy would remove now. */
export type Removal = S['RemovalOut'];

/** The confirmation of exactly this preview. */
export function confirmationOf({ at, frames, frames_bytes, packets, to_thin, events }: Removal): S['ConfirmedIn'] {
  return { at, frames, frames_bytes, packets, to_thin, events };
}

export const admin = {
  users: () => get<UserRow[]>('/users'),
  addUser: (body: S['UserIn']) => post<OneTimeLink>('/users', body),
  changeUser: (id: number, body: S['UserChangeIn']) => send<UserRow>('PUT', `/users/${id}`, body),
  newLink: (id: number) => post<OneTimeLink>(`/users/${id}/link`),
  sessions: () => get<SessionRow[]>('/sessions'),
  endSession: (id: number) => send<null>('DELETE', `/sessions/${id}`),
  tokens: () => get<TokenRow[]>('/tokens'),
  addToken: (body: S['TokenIn']) => post<S['NewTokenOut']>('/tokens', body),
  revokeToken: (id: number) => send<null>('DELETE', `/tokens/${id}`),
  audit: (filter: Record<string, string | number | undefined>) => get<AuditRow[]>(`/audit${query(filter)}`),
  verifyAudit: () => get<AuditVerdict>('/audit/verify'),
  health: () => get<Health>('/admin/health'),
  backups: () => get<Backup[]>('/admin/backups'),
  backUp: () => post<Job>('/admin/backups'),
  checkStore: () => post<Job>('/admin/check-store'),
  retention: () => get<Retention>('/admin/retention'),
  chooseRetention: (policy: Policy) => send<Retention>('PUT', '/admin/retention', policy),
  previewRetention: (policy: Policy, signal: AbortSignal) => post<Removal>('/admin/retention/preview', policy, signal),
  runRetention: (seen: Removal | null) => post<Job>('/admin/retention/run', { confirmed: seen && confirmationOf(seen) }),
  confirmClock: (seen: string) => post<Retention>('/admin/retention/confirm-clock', { seen }),
};
