/** Pages of the sidebar, in order. The number keys use this order; `letter` is the key after g. */
export interface Page {
  path: string;
  name: string;
  letter: string;
  icon: string;
  permission?: string;
}
/** Pages at the root of a server with several units. */
export const ROOT_PAGES: readonly Page[] = [
  { path: '/fleet', name: 'Fleet', letter: 'u', icon: 'fleet' },
  { path: '/admin', name: 'Admin', letter: 'a', icon: 'admin', permission: 'admin.health' },
];
export const PAGES: readonly Page[] = [
  { path: '/live', name: 'Live', letter: 'l', icon: 'live' },
  { path: '/commands', name: 'Commands', letter: 'c', icon: 'commands' },
  { path: '/telemetry', name: 'Telemetry', letter: 't', icon: 'telemetry' },
  { path: '/frames', name: 'Frames', letter: 'f', icon: 'frames' },
  { path: '/catalogues', name: 'Catalogues', letter: 'k', icon: 'catalogues' },
  { path: '/calibration', name: 'Calibration', letter: 'b', icon: 'calibration' },
  { path: '/campaigns', name: 'Campaigns', letter: 'm', icon: 'campaigns' },
  { path: '/contacts', name: 'Contacts', letter: 'o', icon: 'contacts' },
  { path: '/passes', name: 'Passes', letter: 'p', icon: 'passes' },
  { path: '/procedures', name: 'Procedures', letter: 'r', icon: 'procedures' },
  { path: '/instruments', name: 'Instruments', letter: 'i', icon: 'instruments' },
  { path: '/admin', name: 'Admin', letter: 'a', icon: 'admin', permission: 'admin.health' },
];
