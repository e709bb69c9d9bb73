/** Guide chapter of each page; tests/house/test_help_and_roles_pages.py checks that each chapter exists. */
const CHAPTERS: Record<string, string> = {
  fleet: 'operator#several-units',
  live: 'operator#during',
  commands: 'operator#during',
  procedures: 'operator#procedures',
  telemetry: 'operator#alarms',
  frames: 'engineer#one-frame',
  catalogues: 'catalogue-manager#build',
  calibration: 'engineer#a-camera-from-its-own-frames',
  sheet: 'engineer#performance-sheet',
  campaigns: 'engineer#campaigns',
  contacts: 'operator#after',
  passes: 'operator#passes',
  instruments: 'catalogue-manager#instruments',
  rerun: 'engineer#rerun',
  admin: 'admin#people',
};

export function helpFor(section: string): string {
  const chapter = CHAPTERS[section];
  return chapter ? `/help/${chapter}` : '/help';
}
