/** The pages of the rail, in its order; the number keys and the letters after g follow it. */
export interface Page { path: string; name: string; letter: string; icon: string; permission?: string }
export const PAGES: readonly Page[] = [
  { path: '/live', name: 'Live', letter: 'l', icon: 'live' },
  { path: '/commands', name: 'Commands', letter: 'c', icon: 'commands' },
  { path: '/telemetry', name: 'Telemetry', letter: 't', icon: 'telemetry' },
  { path: '/frames', name: 'Frames', letter: 'f', icon: 'frames' },
  { path: '/catalogues', name: 'Catalogues', letter: 'k', icon: 'catalogues' },
  { path: '/calibration', name: 'Calibration', letter: 'b', icon: 'calibration' },
  { path: '/campaigns', name: 'Campaigns', letter: 'm', icon: 'campaigns' },
  { path: '/contacts', name: 'Contacts', letter: 'o', icon: 'contacts' },
  { path: '/admin', name: 'Admin', letter: 'a', icon: 'admin', permission: 'admin.health' },
];
