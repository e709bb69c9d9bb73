import { expect, test, vi } from 'vitest';
import type { AlarmRow } from '../api/types';

type Listener = (e: { data: string; lastEventId: string }) => void;
const listeners = new Map<string, Listener>();
class Source {
  addEventListener(topic: string, listener: Listener): void {
    listeners.set(topic, listener);
  }
  close(): void {
    listeners.clear();
  }
}

test('an alarm is handled at once while the tab is hidden, because its sound is needed then', async () => {
  const storage = { getItem: () => null, setItem: () => undefined };
  vi.stubGlobal('EventSource', Source);
  vi.stubGlobal('localStorage', storage);
  vi.stubGlobal('document', { hidden: true, addEventListener: () => undefined });
  vi.useFakeTimers();
  const { live } = await import('./live.svelte');
  const stream = live.start();
  const alarm = { id: 7, state: 'raised', level: 'critical', worst: 'critical', raised: '2026-12-01T18:00:00Z' };
  listeners.get('authority')?.({ data: JSON.stringify({ holder: 'ann' }), lastEventId: '1.1' });
  listeners.get('alarm')?.({ data: JSON.stringify(alarm as AlarmRow), lastEventId: '1.2' });
  expect(live.alarms.map((a) => a.id)).toEqual([7]);
  expect(live.authority).toBeNull();
  stream.stop();
});
