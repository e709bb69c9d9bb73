/** Telemetry of the displayed period, which follows the clock or is fixed in the past. Live values are appended. */
import { api } from '../../api/client';
import type { History } from '../../api/types';
import { problemText } from '../../lib/problems';
import { happened, type Happening } from './happenings.svelte';
import { keyOf, live } from '../../state/live.svelte';

export const SPANS = { Live: 180, '15 min': 900, '1 h': 3600, '6 h': 21_600, '24 h': 86_400 } as const;
export type Span = keyof typeof SPANS;
/** Value of the query `plot` if the user has removed all plots. Without it, those with limits are plotted. */
export const NO_PLOTS = 'none';
/** Return the parameters that the query `plot` names. */
export const plottedIn = (plot: string): string[] => plot.split(',').filter((key) => key && key !== NO_PLOTS);
const POINTS = 800;

export class TelemetryHistory {
  history = $state.raw<History | null>(null);
  happenings = $state.raw<Happening[]>([]);
  problem = $state('');

  /** Load the whole period. A response after `stop` is discarded. */
  async read(fields: readonly string[], start: string, end: string, stop: AbortSignal): Promise<void> {
    try {
      const [history, list] = await Promise.all([
        fields.length ? api.history([...fields], start, end, POINTS) : null,
        happened(start, end).catch(() => []),
      ]);
      if (stop.aborted) return;
      this.history = history;
      this.happenings = list;
      this.problem = '';
    } catch (e) {
      if (!stop.aborted) this.problem = problemText(e);
    }
  }

  /** Append the latest values of the stream to each series, and move the period to the present time. */
  follow(seconds: number): void {
    const h = this.history;
    if (!h) return;
    const now = Date.now() + live.clockSkewMs;
    const values = new Map(live.values.map((v) => [keyOf(v), v]));
    const series = h.series.map((s) => {
      const v = values.get(keyOf(s));
      const t = v?.at ? Date.parse(v.at) / 1000 : 0;
      const y =
        typeof v?.value === 'number'
          ? v.value
          : typeof v?.value === 'string'
            ? (s.choices.find((c) => c.name === v.value)?.value ?? null)
            : null;
      return t > (s.t.at(-1) ?? 0) ? { ...s, t: [...s.t, t], y: [...s.y, y] } : s;
    });
    this.history = { start: new Date(now - seconds * 1000).toISOString(), end: new Date(now).toISOString(), series };
  }
}
