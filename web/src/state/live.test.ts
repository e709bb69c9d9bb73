import { afterEach, beforeEach, expect, test, vi } from 'vitest';
import type { AlarmRow, Command, Link, Stage } from '../api/types';

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

beforeEach(() => {
  vi.stubGlobal('EventSource', Source);
  vi.stubGlobal('localStorage', { getItem: () => null, setItem: () => undefined });
  vi.stubGlobal('document', { hidden: true, addEventListener: () => undefined });
  vi.useFakeTimers();
});
afterEach(() => {
  vi.useRealTimers();
});

test('an alarm is handled at once while the tab is hidden, because its sound is needed then', async () => {
  const { live } = await import('./live.svelte');
  const stream = live.start();
  const alarm = { id: 7, state: 'raised', level: 'critical', worst: 'critical', raised: '2026-12-01T18:00:00Z' };
  listeners.get('authority')?.({ data: JSON.stringify({ holder: 'ann' }), lastEventId: '1.1' });
  listeners.get('alarm')?.({ data: JSON.stringify(alarm as AlarmRow), lastEventId: '1.2' });
  expect(live.alarms.map((a) => a.id)).toEqual([7]);
  expect(live.authority).toBeNull();
  stream.stop();
});

test('a command that the server rejects is reported once, and one that the sensor rejects also', async () => {
  const { live, sendCommand } = await import('./live.svelte');
  const { toasts } = await import('./toasts.svelte');
  const { api, ApiError } = await import('../api/client');
  toasts.list = [];
  const row = (id: number, result: string, sentAt: string | null): Command =>
    ({ id, name: 'GET_STATUS', result, stages: [{ name: 'sent', at: sentAt } as Stage] }) as Command;
  const message = 'ABORT was requested before this command was sent.';
  const problem = { id: '', message, expected: '', got: '', hint: '' };
  vi.spyOn(api, 'send').mockRejectedValue(new ApiError(409, problem));
  live.put('command', row(1, 'queued', null));
  await sendCommand('GET_STATUS');
  live.put('command', { ...row(1, 'rejected', null), detail: message });
  live.put('command', row(2, 'rejected', '2026-12-01T18:00:00Z'));
  expect(toasts.list.map((t) => t.text)).toEqual([message, 'GET_STATUS rejected']);
});

test('whether a command can be retried is read again when another unit answers', async () => {
  const { live } = await import('./live.svelte');
  const { api } = await import('../api/client');
  const lost = { id: 3, name: 'TAKE_IMAGE', result: 'unknown', can_retry: true } as Command;
  vi.spyOn(api, 'findCommands').mockResolvedValue([{ ...lost, can_retry: false }]);
  live.put('link', { device: 'FM-1' } as Link);
  live.put('command', lost);
  const shown = (): boolean | undefined => live.commands.find((c) => c.id === 3)?.can_retry;
  expect(shown()).toBe(true);
  live.put('link', { device: 'FM-2' } as Link);
  await vi.waitFor(() => expect(shown()).toBe(false));
});

test('a part of the state that could not be loaded is loaded again', async () => {
  const { live } = await import('./live.svelte');
  const { api } = await import('../api/client');
  vi.stubGlobal('fetch', () => Promise.reject(new Error('no connection')));
  vi.spyOn(api, 'alarms').mockRejectedValueOnce(new Error('The database is busy.')).mockResolvedValue([]);
  live.online = true;
  await live.load();
  expect(live.alarmsRead).toBe(false);
  await vi.advanceTimersByTimeAsync(5000);
  expect(live.alarmsRead).toBe(true);
});
