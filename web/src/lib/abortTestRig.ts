/** A server, a clock and a storage for the tests of ABORT, controlled by the test. */
import { ApiError } from '../api/client';
import type { Abort, Command, Stage } from '../api/types';
import { Presses } from './abort';
import type { Press } from './abortPress';

export const FIRST_START = '2026-12-01T16:00:00.000Z';
const START = Date.parse('2026-12-01T18:42:07Z');
export const UNREACHABLE = (): ApiError =>
  new ApiError(0, { id: '', message: 'no answer', expected: '', got: '', hint: '' });
export const refused = (status: number, message: string, got = ''): ApiError =>
  new ApiError(status, { id: 'x', message, expected: '', got, hint: '' });
export function command(over: Partial<Command> = {}): Command {
  const stages: Stage[] = [
    { name: 'queued', state: 'passed', at: '2026-12-01T18:42:07.100Z' },
    { name: 'sent', state: 'passed', at: '2026-12-01T18:42:07.200Z' },
  ];
  return {
    id: 5,
    request_id: 23,
    name: 'ABORT',
    user: 'kim',
    created: '2026-12-01T18:42:07.100Z',
    result: 'sent',
    detail: '',
    stages,
    ...over,
  } as Command;
}

export const receipt = (command: Command | null): Abort => ({
  request_id: 23,
  at: '2026-12-01T18:42:07.050Z',
  command,
});

/** A clock that moves only when it is advanced, a server that answers as `answers` specifies, and a storage. */
export function rig(
  answers: (Command | Abort | Error | 'hang')[],
  over: { online?: boolean; reachable?: boolean | 'hang'; stored?: string; history?: Command[]; storage?: Error } = {},
) {
  let now = START;
  let timers: { at: number; run: () => void }[] = [];
  const seen: {
    presses: readonly Press[];
    saved: string;
    posts: number;
    servers: (string | null)[];
    searches: number;
  } = {
    presses: [],
    servers: [],
    saved: over.stored ?? '[]',
    posts: 0,
    searches: 0,
  };
  const world: { online: boolean; reachable: boolean | 'hang'; history: Command[] | Error | 'hang' } = {
    online: over.online ?? true,
    reachable: over.reachable ?? over.online ?? true,
    history: over.history ?? [],
  };
  const presses = new Presses({
    serverStarted: () => FIRST_START,
    post: (_signal, serverStarted) => {
      seen.posts += 1;
      seen.servers.push(serverStarted);
      const next = answers.length > 1 ? answers.shift() : answers[0];
      return next === 'hang'
        ? new Promise(() => undefined)
        : next instanceof Error
          ? Promise.reject(next)
          : Promise.resolve('stages' in (next as object) ? receipt(next as Command) : (next as Abort));
    },
    probe: () => (world.reachable === 'hang' ? new Promise(() => undefined) : Promise.resolve(world.reachable)),
    history: (start, end) => {
      seen.searches += 1;
      if (world.history === 'hang') return new Promise(() => undefined);
      return world.history instanceof Error
        ? Promise.reject(world.history)
        : Promise.resolve(world.history.filter((c) => Date.parse(c.created) >= start && Date.parse(c.created) < end));
    },
    online: () => world.online,
    now: () => now,
    user: () => 'kim',
    later: (run, ms) => {
      const timer = { at: now + ms, run };
      timers.push(timer);
      return () => {
        timers = timers.filter((t) => t !== timer);
      };
    },
    load: () => {
      if (over.storage) throw over.storage;
      return seen.saved;
    },
    save: (text) => {
      if (over.storage) throw over.storage;
      seen.saved = text;
    },
    changed: (list) => {
      seen.presses = list;
    },
  });
  const settle = (): Promise<void> => new Promise((r) => setTimeout(r, 0));
  async function pass(ms: number): Promise<void> {
    const end = now + ms;
    for (;;) {
      await settle();
      const due = timers.filter((t) => t.at <= end).sort((a, b) => a.at - b.at)[0];
      if (!due) break;
      timers = timers.filter((t) => t !== due);
      now = due.at;
      due.run();
    }
    now = end;
    await settle();
  }
  return { presses, seen, pass, world };
}

/** The newest press. */
export const shown = (seen: { presses: readonly Press[] }): Press => seen.presses[0] as Press;
