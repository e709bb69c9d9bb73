/** What each permission is in words, and whose it is. Held equal to the server's table by tests/house/test_roles_page.py. */
export const ROLES = ['viewer', 'operator', 'catalogue manager', 'engineer', 'admin'] as const;

/** Permission, or its part before the dot: the words for doing it, and the roles beside admin that may. */
export const WORDS: Record<string, [string, readonly string[]]> = {
  view: ['looking', ['viewer', 'operator', 'catalogue manager', 'engineer']],
  command: ['commanding', ['operator']],
  'command.catalogue': ['commanding the catalogue banks', ['operator', 'catalogue manager']],
  'command.imager': ['commanding the imager', ['operator', 'engineer']],
  'link.open': ['opening and closing the link', ['operator']],
  alarms: ['working on alarms', ['operator']],
  limits: ['choosing limits', ['operator']],
  stacks: ['running stacks', ['operator']],
  schedule: ['scheduling', ['operator']],
  'authority.take': ['taking command authority', ['operator', 'catalogue manager', 'engineer']],
  'authority.break': ['breaking command authority', ['operator']],
  'frames.import': ['importing images', ['engineer']],
  'frames.transfer': ['moving frames to and from the device', ['operator', 'engineer']],
  'frames.solve': ['running a chain on a frame', ['operator', 'engineer']],
  'frames.pin': ['choosing the operational ground result', ['engineer']],
  'catalogues.build': ['building catalogues', ['catalogue manager']],
  'catalogues.upload': ['uploading catalogues', ['operator', 'catalogue manager']],
  tables: ['changing tables', ['operator', 'catalogue manager', 'engineer']],
  calibrate: ['calibrating', ['engineer']],
  analyse: ['analysing', ['engineer']],
  campaigns: ['running campaigns', ['engineer']],
  'contacts.note': ['writing notes on contacts', ['operator', 'engineer']],
  replay: ['replaying contacts', ['operator', 'engineer']],
  'jobs.cancel': ['cancelling jobs', ['operator', 'catalogue manager', 'engineer']],
  'admin.users': ['managing users', []],
  'admin.tokens': ['managing tokens', []],
  'admin.audit': ['reading the audit log', []],
  'admin.health': ['reading the health page', []],
  'admin.retention': ['storage and retention', []],
  'admin.backup': ['backups', []],
  stop: ['stopping', ['viewer', 'operator', 'catalogue manager', 'engineer']],
  metrics: ['reading the metrics', ['viewer', 'operator', 'catalogue manager', 'engineer']],
};

export function article(role: string): string {
  return `${/^[aeiou]/.test(role) ? 'an' : 'a'} ${role}`;
}

function owners(roles: readonly string[]): string {
  const named = roles.length ? roles : ['admin'];
  return named.map((r) => `${r}'s`).join(' or ');
}

/** Roles beside admin that hold the permission. */
export function holders(permission: string): readonly string[] {
  return (WORDS[permission] ?? WORDS[permission.split('.')[0] ?? ''])?.[1] ?? [];
}

/** "commanding needs the operator's role, you are a viewer". */
export function lacking(permission: string, role: string): string {
  const [words, roles] = WORDS[permission] ?? WORDS[permission.split('.')[0] ?? ''] ?? [permission, []];
  return `${words} needs the ${owners(roles)} role, you are ${article(role || 'guest')}`;
}
