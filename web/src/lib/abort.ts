/**
 * Track each press of ABORT until its result. A press is never lost: it ends with the device's report, or as `not_sent`
 * or `unknown`, which the strip shows until an operator acknowledges it. The request is retried until WINDOW_MS after
 * the press and then cancelled. It is not sent later, because the state of the sensor may have changed; the operator
 * decides whether to send ABORT again.
 */
import { ApiError } from '../api/client';
import type { Abort, Command } from '../api/types';
import { isCompleted, isOpen, isOver, type Press } from './abortPress';

export const WINDOW_MS = 5_000;
const PAUSE_MS = 500;
/**
 * Maximum time from the server's answer until the command is recorded. The server answers as soon as ABORT is queued
 * for the line. The page can show the stages of the command only after it is recorded.
 */
export const RECORD_MS = 10_000;
/**
 * Interval of the searches in the command history, and minimum age of a press before its command is reported as
 * missing. The server can record a command late.
 */
export const SEARCH_EVERY_MS = 3_000;
export const SEARCH_UNTIL_MS = 60_000;
/**
 * Tolerance for the difference between the clocks of page and server, which is about a second. A command that was
 * created at most this time before the press can belong to the press.
 */
const CLOCK_MS = 2_000;

export type Answer = Pick<Press, 'reason' | 'answered'> & { fate: 'not_sent' | 'unknown' };

export interface AbortParts {
  /** Send ABORT to the server that started at `serverStarted`; null: to any server. */
  post: (signal: AbortSignal, serverStarted: string | null) => Promise<Abort>;
  /** Start of the server whose state the page shows; null if unknown. */
  serverStarted: () => string | null;
  /** ABORT commands created in a time span, from the server's history. */
  history: (startMs: number, endMs: number, signal: AbortSignal) => Promise<Command[]>;
  /** True if the event stream is open. */
  online: () => boolean;
  /** Request the server's health. Returns false only if no connection could be opened. */
  probe: (signal: AbortSignal) => Promise<boolean>;
  /** UTC of the server's clock, in milliseconds. */
  now: () => number;
  user: () => string;
  later: (run: () => void, ms: number) => () => void;
  load: () => string | null;
  save: (text: string) => void;
  changed: (presses: readonly Press[]) => void;
}

/**
 * Start of the present server, from its rejection of a request that was meant for the server before a restart; "" for
 * every other error. A request can wait in the connection until the server has started again, and would then send ABORT
 * after the press has ended.
 */
function restartOf(error: unknown): string {
  return error instanceof ApiError && error.status === 412 ? error.problem.got : '';
}

/** True if the server itself answered with an error. */
function isAnswer(error: unknown): error is ApiError {
  return error instanceof ApiError && error.status >= 400;
}

/**
 * Return the result of a press after an error. `mayHaveLeft`: true if an attempt ended without an answer, and the
 * server was perhaps reachable. A browser reports refused and broken connections identically, so a press is "not sent"
 * in only two cases: the server rejected the request, or no connection could be opened. If an earlier attempt has
 * perhaps reached the server, a later rejection does not show whether the server sent ABORT for that attempt.
 */
export function answerOf(error: unknown, mayHaveLeft: boolean, timedOut: boolean): Answer {
  if (isAnswer(error)) {
    const { message, got } = error.problem;
    const text = `the server answered ${error.status}: ${message.replace(/\.$/, '')}${got ? ` (${got})` : ''}`;
    if (error.status >= 500) return { fate: 'unknown', reason: text, answered: true };
    return mayHaveLeft
      ? {
          fate: 'unknown',
          reason: `an earlier attempt broke before the server answered; ${text}`,
          answered: false,
        }
      : { fate: 'not_sent', reason: text, answered: true };
  }
  if (timedOut)
    return { fate: 'unknown', reason: `no answer from the server within ${WINDOW_MS / 1000} s`, answered: false };
  return mayHaveLeft
    ? { fate: 'unknown', reason: 'the connection broke before the server answered', answered: false }
    : { fate: 'not_sent', reason: 'the server could not be reached', answered: false };
}

/** Attempts of one press that ended without an answer, and the results of their probes. */
class LostAttempts {
  private reachable = false;
  private pending = 0;

  add(online: boolean, probe: Promise<boolean>): void {
    this.reachable ||= online;
    this.pending += 1;
    void probe
      .catch(() => true)
      .then((connected) => {
        this.reachable ||= connected;
        this.pending -= 1;
      });
  }

  /** False only if the stream was closed and every probe failed. */
  get mayHaveLeft(): boolean {
    return this.reachable || this.pending > 0;
  }
}

/**
 * True if the command can belong to the press: it has the same request id, or, if the press has no request id, it was
 * created at about the time of the press.
 */
function belongs(command: Command, press: Press): boolean {
  if (command.name !== 'ABORT' || command.user !== press.user) return false;
  if (press.requestId !== null) return press.requestId === command.request_id;
  const after = Date.parse(command.created) - press.pressedMs;
  return after >= -CLOCK_MS && after <= WINDOW_MS + CLOCK_MS;
}

export class Presses {
  private list: readonly Press[];
  /** Commands as last reported; the answer to a request can arrive after a newer report. */
  private reported: readonly Command[] = [];
  private searching = false;

  constructor(private readonly parts: AbortParts) {
    this.list = restored(parts.load);
    this.publish();
  }

  /** Send ABORT. Returns when the server has answered, or when the press has ended as not sent or unknown. */
  async press(): Promise<void> {
    const key = `${this.parts.now()}-${this.list.length}`;
    const press: Press = {
      key,
      user: this.parts.user(),
      pressedMs: this.parts.now(),
      fate: 'sending',
      reason: '',
      tries: 0,
      requestId: null,
      command: null,
      notInHistory: false,
      answered: false,
    };
    this.put(press);
    const cancel = new AbortController();
    const stop = this.parts.later(() => cancel.abort(), WINDOW_MS);
    const windowEnd = rejectOnAbort(cancel.signal);
    const lost = new LostAttempts();
    let serverStarted = this.parts.serverStarted();
    for (let tries = 1; ; tries += 1) {
      this.change(key, { tries });
      const online = this.parts.online();
      const request = this.parts.post(cancel.signal, serverStarted);
      const probe = this.parts.probe(cancel.signal);
      try {
        const receipt = await Promise.race([request, windowEnd]);
        stop();
        return this.acceptReceipt(key, receipt);
      } catch (error) {
        const restart = restartOf(error);
        if (restart && restart !== serverStarted && !cancel.signal.aborted) {
          serverStarted = restart; // the press is younger than WINDOW_MS, so it is meant for this server too
          continue;
        }
        const [answered, timedOut] = [isAnswer(error), cancel.signal.aborted];
        if (!answered) lost.add(online || this.parts.online(), probe);
        if (!answered && !timedOut) {
          await Promise.race([this.pause(PAUSE_MS), windowEnd]).catch(() => undefined);
          if (!cancel.signal.aborted) continue;
        }
        stop();
        const answer = answerOf(error, lost.mayHaveLeft, timedOut);
        const effort =
          answered || timedOut
            ? ''
            : ` in ${tries} ${tries === 1 ? 'attempt' : 'attempts'} within ${WINDOW_MS / 1000} s`;
        return this.change(key, { ...answer, reason: answer.reason + effort });
      }
    }
  }

  private pause(ms: number): Promise<void> {
    return new Promise((next) => this.parts.later(next, ms));
  }

  private acceptReceipt(key: string, { request_id, command }: Abort): void {
    this.change(key, { fate: command ? 'recorded' : 'taken', requestId: request_id, command });
    this.reconcile(this.reported);
    if (command) return;
    this.parts.later(() => {
      if (this.list.some((p) => p.key === key && p.fate === 'taken'))
        this.change(key, {
          fate: 'unknown',
          reason: `the server queued ABORT for the line (#${request_id}) and has not recorded it`,
        });
    }, RECORD_MS);
  }

  /** Merge commands reported by the stream or the history. */
  reconcile(commands: readonly Command[]): void {
    this.reported = commands;
    for (const press of this.list) {
      const newer = press.command && commands.find((c) => c.id === press.command?.id);
      if (newer && newer !== press.command) this.change(press.key, { command: newer });
    }
    this.claim(commands);
  }

  /** Assign to each press without a command the command that the server created for it. */
  private claim(commands: readonly Command[]): void {
    const assigned = new Set(this.list.map((p) => p.command?.id));
    for (const press of this.list.filter((p) => p.command === null && p.fate !== 'sending')) {
      const command = commands.find((c) => !assigned.has(c.id) && belongs(c, press));
      if (!command) continue;
      assigned.add(command.id);
      this.change(press.key, { fate: 'recorded', command, reason: '' });
    }
  }

  /**
   * Search the server's command history for presses without an answer until each command is found or is certainly
   * missing. Ends when the event stream closes; call it again after a reconnection.
   */
  async check(): Promise<void> {
    if (this.searching) return;
    this.searching = true;
    try {
      while (this.parts.online() && this.list.some(isOpen)) {
        for (const press of this.list.filter(isOpen)) await this.search(press);
        if (this.list.some(isOpen)) await this.pause(SEARCH_EVERY_MS);
      }
    } finally {
      this.searching = false;
    }
  }

  private async search(press: Press): Promise<void> {
    const cancel = new AbortController();
    const stop = this.parts.later(() => cancel.abort(), SEARCH_EVERY_MS);
    const old = this.parts.now() - press.pressedMs >= SEARCH_UNTIL_MS;
    const end = press.requestId === null ? press.pressedMs + WINDOW_MS : this.parts.now();
    const commands = await Promise.race([
      this.parts.history(press.pressedMs - CLOCK_MS, end + CLOCK_MS, cancel.signal),
      rejectOnAbort(cancel.signal),
    ]).catch(() => null);
    stop();
    if (!commands) return;
    this.claim(commands);
    if (old && !this.list.find((p) => p.key === press.key)?.command) this.change(press.key, { notInHistory: true });
  }

  /** Remove every ended press from the strip. */
  acknowledge(): void {
    this.list = this.list.filter((p) => !isOver(p));
    this.publish();
  }

  /** Add a press. Removes only completed presses; all others stay, whatever their number. */
  private put(press: Press): void {
    this.list = [press, ...this.list.filter((p) => !isCompleted(p))];
    this.publish();
  }

  private change(key: string, to: Partial<Press>): void {
    this.list = this.list.map((p) => (p.key === key ? { ...p, ...to } : p));
    this.publish();
  }

  private publish(): void {
    this.parts.changed(this.list);
    try {
      this.parts.save(JSON.stringify(this.list));
    } catch {
      /* Full or blocked storage must not prevent ABORT; the presses are then lost when the page is reloaded. */
    }
  }
}

/** Return the presses stored before the page was reloaded. A press that was in progress has lost its answer. */
function restored(load: () => string | null): Press[] {
  try {
    const list = JSON.parse(load() ?? '[]') as Press[];
    return list.map((p) =>
      p.fate === 'sending' || p.fate === 'taken'
        ? {
            ...p,
            fate: 'unknown',
            reason:
              p.fate === 'sending'
                ? 'the page was reloaded before the server answered'
                : 'the page was reloaded before the server recorded ABORT',
          }
        : p,
    );
  } catch {
    return [];
  }
}

/** Return a promise that rejects when the signal aborts, even if the request ignores the signal. */
function rejectOnAbort(signal: AbortSignal): Promise<never> {
  const promise = new Promise<never>((_, reject) =>
    signal.addEventListener('abort', () => reject(new DOMException('no answer in time', 'AbortError')), { once: true }),
  );
  promise.catch(() => undefined);
  return promise;
}
