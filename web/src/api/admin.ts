/** What an admin asks and changes; apart from client.ts, so that it is fetched with the page only. */
import { get, post, query, send } from './client';
import type { Job } from './types';

export interface UserRow { id: number; name: string; role: string; enabled: boolean; has_password: boolean; created: string; created_by: string; last_sign_in: string | null }
export interface OneTimeLink { link: string; expires: string }
export interface SessionRow { id: number; name: string; role: string; created: string; last_seen: string; expires: string; address: string; agent: string; own: boolean }
export interface TokenRow { id: number; name: string; role: string; scopes: string[]; created: string; created_by: string; expires: string; revoked: string | null; last_used: string | null }
export interface AuditRow { seq: number; at: string; who: string; role: string; action: string; target: string; result: string; detail: string; address: string }
export interface AuditVerdict { rows: number; last_hash: string; problem: string }
export interface HealthCheck { name: string; state: string; value: number | null; text: string }
export interface Health { state: string; checks: HealthCheck[] }
export interface Backup { name: string; created: string; version: string; bytes: number; blobs: number; captures: number }
export interface Policy { frames_days: number; frames_gb: number; keep_frames: number; telemetry_thin_days: number; telemetry_days: number; events_days: number; captures_mb: number; backups_keep: number }
export interface Forecast { database_bytes: number; frames_bytes: number; captures_bytes: number; free_bytes: number; bytes_now: number; bytes_per_day: number; full_in_days: number | null; next_removal: string | null; removable_bytes: number }
export interface Retention extends Policy { last_run: string | null; forecast: Forecast }
/** What a policy would remove now. */
export interface Removal { frames: number; frames_bytes: number; packets: number; to_thin: number; events: number }

export const admin = {
  users: () => get<UserRow[]>('/users'),
  addUser: (name: string, role: string) => post<OneTimeLink>('/users', { name, role }),
  changeUser: (id: number, body: { role?: string; enabled?: boolean }) => send<UserRow>('PUT', `/users/${id}`, body),
  newLink: (id: number) => post<OneTimeLink>(`/users/${id}/link`),
  sessions: () => get<SessionRow[]>('/sessions'),
  endSession: (id: number) => send<null>('DELETE', `/sessions/${id}`),
  tokens: () => get<TokenRow[]>('/tokens'),
  addToken: (body: { name: string; role: string; days: number; scopes: string[] }) => post<{ key: string }>('/tokens', body),
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
  runRetention: () => post<Job>('/admin/retention/run'),
};
