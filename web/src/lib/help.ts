/** Which chapter of the documents belongs to which page; tests/house/test_help_links.py holds that each is there. */
const CHAPTERS: Record<string, string> = {
  live: 'operator#during',
  commands: 'operator#during',
  telemetry: 'operator#alarms',
  frames: 'engineer#one-frame',
  catalogues: 'catalogue-manager#build',
  calibration: 'engineer#a-camera-from-its-own-frames',
  campaigns: 'engineer#campaigns',
  contacts: 'operator#after',
  rerun: 'engineer#rerun',
  admin: 'admin#people',
};

export function helpFor(section: string): string {
  const chapter = CHAPTERS[section];
  return chapter ? `/help/${chapter}` : '/help';
}
