/** Permissions in words, and the roles that have them. */
import { ROLE_PERMISSIONS } from '../api/generated/roles';

export type Role = keyof typeof ROLE_PERMISSIONS;
export type Permission = (typeof ROLE_PERMISSIONS)[Role][number];
export const ROLES = Object.keys(ROLE_PERMISSIONS) as Role[];

/**
 * Description of each permission. The commands of most subsystems share one entry. A permission without a description
 * does not compile.
 */
export const WORDS: Record<
  Exclude<Permission, `command.${string}`> | 'command' | 'command.catalogue' | 'command.imager',
  string
> = {
  view: 'viewing',
  command: 'commanding',
  'command.catalogue': 'commanding the catalogue banks',
  'command.imager': 'commanding the imager',
  'link.open': 'opening and closing the link',
  alarms: 'handling alarms',
  limits: 'selecting limit sets',
  derived: 'defining derived parameters',
  procedures: 'writing and running procedures',
  schedule: 'scheduling',
  passes: 'planning passes',
  views: 'storing views',
  heads: 'changing the mountings of heads',
  'authority.take': 'taking command authority',
  'authority.break': 'breaking command authority',
  'frames.import': 'importing images',
  'frames.transfer': 'transferring frames',
  'frames.solve': 'running a chain on a frame',
  'frames.pin': 'selecting the operational ground result',
  'catalogues.build': 'building catalogues',
  'catalogues.upload': 'uploading catalogues',
  tables: 'changing tables',
  instruments: 'installing instruments',
  calibrate: 'calibrating',
  analyse: 'analysing',
  campaigns: 'running campaigns',
  'contacts.note': 'writing notes on contacts',
  replay: 'replaying contacts',
  'jobs.cancel': 'cancelling jobs',
  'admin.users': 'managing users',
  'admin.tokens': 'managing tokens',
  'admin.audit': 'reading the audit log',
  'admin.health': 'reading the health page',
  'admin.retention': 'managing storage and retention',
  'admin.backup': 'managing backups',
  stop: 'stopping',
  metrics: 'reading the metrics',
};

function wordsOf(permission: string): string {
  const words: Record<string, string> = WORDS;
  return words[permission] ?? words[permission.split('.')[0] ?? ''] ?? permission;
}

export function article(role: string): string {
  return `${/^[aeiou]/.test(role) ? 'an' : 'a'} ${role}`;
}

function owners(roles: readonly string[]): string {
  const named = roles.length ? roles : ['admin'];
  return named.map((r) => `${r}'s`).join(' or ');
}

/** Return the roles other than admin that include the permission; `command` alone means any command permission. */
export function holders(permission: string): readonly Role[] {
  const holds = (granted: string) =>
    granted === permission || (permission === 'command' && granted.startsWith('command.'));
  return ROLES.filter((role) => role !== 'admin' && ROLE_PERMISSIONS[role].some(holds));
}

/** Return why a permission is missing: "commanding needs the operator's role, you are a viewer". */
export function lacking(permission: string, role: string): string {
  return `${wordsOf(permission)} needs the ${owners(holders(permission))} role, you are ${article(role || 'guest')}`;
}
