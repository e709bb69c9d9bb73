/** Every indicator of docs/indicators.md: its component draws it with the listed source, driven through all states. */
import { readFileSync } from 'node:fs';
import { describe, expect, it } from 'vitest';
import { freshnessOf, lampWhen, lastReport, noteOf, sourceOf, type Conditions, type Source } from './freshness';

const SRC = new URL('..', import.meta.url);
const DOCUMENT = readFileSync(new URL('../../docs/indicators.md', SRC), 'utf8');
const NOW = Date.parse('2026-12-01T18:42:07Z');

/** Indicator: its source, and where it is drawn, as "file: text of the source". */
const DRAWN: Record<string, [Source, ...string[]]> = {
  'TX, RX': ['server', 'components/shell/Header: lineLamp(line)} from="server"'],
  Mode: [
    'device',
    'components/shell/Header: isCurrent(current.housekeeping)',
    'components/shell/Header: {#if !device}<StateLamp state="ok" from="housekeeping"',
  ],
  Bank: ['device', 'components/shell/Header: state={expiry.state} from="housekeeping"'],
  Dictionary: ['device', 'components/shell/Header: from="housekeeping"'],
  'Worst alarm': [
    'server',
    'components/shell/HeaderAlarm: from="server"',
    'components/shell/HeaderAlarm: live.alarmsRead',
  ],
  UTC: ['server', "components/shell/Header: server ? day(utc) : 'browser clock'"],
  Authority: ['server', 'components/shell/AuthorityCell: from="server"'],
  'Authority bar (request, offer)': ['server', 'components/shell/AuthorityBar: from="server"'],
  'Pass plan strip': ['server', 'components/shell/PlanStrip: from="server"'],
  'Console state (footer)': ['server', "components/shell/Footer: live.online ? 'ok' : 'never'} from=\"server\""],
  'Queue (footer)': ['server', "components/shell/Footer: !current.isCurrent('server') ? 'queue unknown'"],
  'Cycle, steps "cycling"': ['device', 'pages/live/CommandPanel: state="progress" from="device"'],
  'Cycle bars, "now"': ['device', 'pages/live/CycleBars: current.cycle.running'],
  'Frame state': ['device', 'pages/live/Page: exposureOf(', 'pages/live/Page: from="device" word={exposure.words}'],
  'On board and ground agree': [
    'device',
    "pages/live/AttitudePanel: from={d?.source === 'device' ? 'device' : 'record'}",
  ],
  'Sun, Moon, Earth limb': ['device', "pages/live/SkyPanel: freshnessOf('device', current.conditions, attitudeMs)"],
  rate: ['device', 'pages/live/SkyPanel: state={t.state} from="device"'],
  'On board − ground over time; where a frame points; solved field of view': ['record', 'pages/live/DifferenceStrip: '],
  'Next pass, alarms of the summary': ['server', 'pages/live/PhoneSummary: from="server"'],
  'Alarms "Angle to Sun, Moon, Earth limb"': ['server', 'pages/telemetry/MonitorPanel: from="server"'],
  'active bank of a catalogue': ['device', 'pages/catalogues/Page: from="housekeeping"'],
  'settings on board, schedule on board': [
    'device',
    "pages/commands/SchedulePanel: from={e.state === 'waiting' ? 'device' : 'record'}",
    "pages/live/CommandPanel: isCurrent('device')",
  ],
  'Key telemetry, telemetry table and its pages': [
    'device',
    'pages/live/KeyTelemetry: current.lamp',
    'pages/telemetry/TelemetryTable: current.lamp',
    'pages/telemetry/TelemetryPages: from="device"',
  ],
  'Monitor, alarm lamp of the sidebar': [
    'server',
    'pages/telemetry/MonitorPanel: from="server"',
    "components/shell/Rail: from={p.path === '/telemetry' ? 'server' : 'record'}",
  ],
  'Banks: coverage and confirmation; tables on board; active faults': [
    'device',
    'components/device/BanksPanel: from="housekeeping"',
    'components/device/TablesPanel: from="device"',
    'pages/commands/TrainingPanel: from="device"',
  ],
  'Banks: orbit in the envelope of the active catalogue': [
    'server',
    'components/device/OrbitFit: state={LAMPS[compared.state]} word={compared.text} from="server"',
  ],
  'Contact "open"': ['server', 'pages/contacts/Page: from="server"'],
  'Packets stored, gaps': ['record', 'pages/contacts/ContactPanel: contact-coverage'],
  'Command stages and results, job and transfer results': ['record', 'components/status/StateLamp: current.lamp('],
};

/** Names in the tables of header, footer and pages. The page Fleet has its own model and test. */
function listed(): string[] {
  const parts = DOCUMENT.split('\n## ').filter((p) => p.startsWith('Header and footer') || p.startsWith('Pages'));
  return parts.flatMap((p) =>
    p
      .split('\n')
      .filter((line) => line.startsWith('| ') && !line.startsWith('| indicator'))
      .map((line) => line.split('|')[1]?.trim() ?? ''),
  );
}

/** Conditions in which a source has each freshness. */
const STATES: Record<string, (source: Source) => Partial<Conditions>> = {
  fresh: () => ({}),
  ageing: (s) => (s === 'server' ? { serverMs: NOW - 5_000 } : { deviceMs: NOW - 5_000 }),
  stale: (s) => (s === 'server' ? { serverMs: NOW - 20_000 } : { deviceMs: NOW - 20_000 }),
  offline: () => ({ online: false }),
  unknown: (s) => (s === 'server' ? { serverMs: null } : { lineOpen: false }),
};
const BASE: Conditions = { nowMs: NOW, online: true, serverMs: NOW - 400, lineOpen: true, deviceMs: NOW - 600 };

it('the document and this test list the same indicators', () => {
  expect(listed().sort()).toEqual(Object.keys(DRAWN).sort());
});

describe.each(Object.entries(DRAWN))('%s', (_, [source, ...places]) => {
  it.each(places)('is drawn by %s', (place) => {
    const at = place.indexOf(': ');
    const file = readFileSync(new URL(`${place.slice(0, at)}.svelte`, SRC), 'utf8').replace(/\s+/g, ' ');
    expect(file).toContain(place.slice(at + 2).trim());
  });
  it.each(Object.keys(STATES))('%s', (name) => {
    const conditions = { ...BASE, ...STATES[name]?.(source) };
    const freshness = freshnessOf(source, conditions);
    const lamps = (['ok', 'watch', 'warning', 'critical'] as const).map((lamp) => lampWhen(lamp, freshness));
    const note = noteOf(freshness, lastReport(source, conditions), NOW);
    if (source === 'record') {
      expect(freshness).toBe('fresh');
      // Work in progress is valid only while the server reports it.
      const progress = freshnessOf(sourceOf('progress', source), conditions);
      expect(lampWhen('progress', progress)).toBe(name === 'offline' ? 'unreported' : 'progress');
      return;
    }
    expect(freshness).toBe(name);
    const kept = name === 'fresh' || name === 'ageing';
    expect(lamps).toEqual(kept ? ['ok', 'watch', 'warning', 'critical'] : Array(4).fill('unreported'));
    expect(note).toMatch(
      { fresh: /^$/, ageing: /^5\.0 s ago$/ }[name] ?? /^(last reported \d\d:\d\d:\d\dZ|never reported)$/,
    );
  });
});
