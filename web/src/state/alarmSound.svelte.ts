/** Optional sound for new unacknowledged warnings and critical alarms. The choice is stored in the browser. */
import type { AlarmRow } from '../api/types';
import { levelOf } from '../lib/alarms';

const KEY = 'gss-alarm-sound';
const SECONDS = 0.25;

type OpenAlarm = Pick<
  AlarmRow,
  'id' | 'packet' | 'field' | 'state' | 'level' | 'worst' | 'shelved' | 'raised' | 'text'
>;

/** Identity of each alarm that asks for attention. An alarm that becomes critical asks again. */
export function urgent(alarms: readonly OpenAlarm[]): string[] {
  return alarms
    .filter((a) => !a.shelved && a.state !== 'acked' && ['warning', 'critical'].includes(levelOf(a)))
    .map((a) => `${a.id} ${levelOf(a)}`);
}

/** Play a short tone. A browser plays it only after the user has used the page. */
function tone(): void {
  const context = new AudioContext();
  const source = context.createOscillator();
  source.frequency.value = 880;
  source.connect(context.destination);
  source.onended = () => void context.close();
  source.start();
  source.stop(context.currentTime + SECONDS);
}

export class AlarmSound {
  on = $state(false);
  private known: ReadonlySet<string> | null = null;

  constructor(
    private readonly storage: Pick<Storage, 'getItem' | 'setItem'>,
    private readonly play: () => void = tone,
  ) {
    this.on = storage.getItem(KEY) === 'on';
  }

  /** Switch the sound on or off. Switching it on plays it once. */
  toggle(): void {
    this.on = !this.on;
    this.storage.setItem(KEY, this.on ? 'on' : 'off');
    if (this.on) this.play();
  }

  /** Compare the alarms with the previous ones. Alarms of the first call were there before the page. */
  follow(alarms: readonly OpenAlarm[]): void {
    const now = urgent(alarms);
    const known = this.known;
    this.known = new Set(now);
    if (this.on && known && now.some((alarm) => !known.has(alarm))) this.play();
  }
}

export const alarmSound = new AlarmSound(localStorage);
