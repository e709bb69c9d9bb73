/**
 * Requests of the administration pages. They are separate from client.ts, so that the browser loads them only with
 * these pages.
 */
import { body, given, http } from '../../api/http';
import type { components, paths } from '../../api/generated/schema';

type S = components['schemas'];
const { GET, POST, PUT, DELETE } = http;
export type AuditFilter = NonNullable<paths['/api/audit']['get']['parameters']['query']>;
export type UserRow = S['UserOut'];
export type OneTimeLink = S['LinkedUserOut'];
export type SessionRow = S['SignInOut'];
export type TokenRow = S['TokenOut'];
export type AuditRow = S['AuditRowOut'];
export type AuditVerdict = S['AuditVerdictOut'];
export type Health = S['HealthOut'];
export type Notifications = S['NotificationsOut'];
export type Backup = S['BackupOut'];
export type Policy = S['RetentionPolicy'];
export type Retention = S['RetentionOut'];
/** The data that a policy would delete now. */
export type Removal = S['RemovalOut'];

/** Return the confirmation of exactly this preview. */
export function confirmationOf({ at, frames, frames_bytes, packets, to_thin, events }: Removal): S['ConfirmedRemoval'] {
  return { at, frames, frames_bytes, packets, to_thin, events };
}

/** Write the action of an audit row in words: `commands.send_command` becomes "commands: send command". */
export function auditAction(action: string): string {
  return action.replace('.', ': ').replace(/_/g, ' ');
}

/** Write the target of an audit row without the method of the request, because the action states it. */
export function auditTarget(target: string): string {
  return target.replace(/^(GET|POST|PUT|PATCH|DELETE) \/(api\/)?/, '').replace(/\//g, ' ');
}

export const admin = {
  users: () => body(GET('/api/users')),
  addUser: (user: S['UserIn']) => body(POST('/api/users', { body: user })),
  changeUser: (user_id: number, change: S['UserChangeIn']) =>
    body(PUT('/api/users/{user_id}', { params: { path: { user_id } }, body: change })),
  newLink: (user_id: number) => body(POST('/api/users/{user_id}/link', { params: { path: { user_id } } })),
  sessions: () => body(GET('/api/sessions')),
  endSession: (session_id: number) => body(DELETE('/api/sessions/{session_id}', { params: { path: { session_id } } })),
  tokens: () => body(GET('/api/tokens')),
  addToken: (token: S['TokenIn']) => body(POST('/api/tokens', { body: token })),
  revokeToken: (token_id: number) => body(DELETE('/api/tokens/{token_id}', { params: { path: { token_id } } })),
  audit: (filter: AuditFilter) => body(GET('/api/audit', { params: { query: given(filter) } })),
  verifyAudit: () => body(GET('/api/audit/verify')),
  health: (signal: AbortSignal) => body(GET('/api/admin/health', { signal })),
  notifications: () => body(GET('/api/notifications')),
  testNotification: (target: string) => body(POST('/api/notifications/test', { body: { target } })),
  backups: () => body(GET('/api/admin/backups')),
  backUp: () => body(POST('/api/admin/backups')),
  checkStore: () => body(POST('/api/admin/check-store')),
  retention: () => body(GET('/api/admin/retention')),
  chooseRetention: (policy: Policy) => body(PUT('/api/admin/retention', { body: policy })),
  previewRetention: (policy: Policy, signal: AbortSignal) =>
    body(POST('/api/admin/retention/preview', { body: policy, signal, keepalive: false })),
  runRetention: (seen: Removal | null) =>
    body(POST('/api/admin/retention/run', { body: { confirmed: seen && confirmationOf(seen) } })),
  confirmClock: (seen: string) => body(POST('/api/admin/retention/confirm-clock', { body: { seen } })),
};
