/** `unreported`: the source does not report at present, so the state is unknown. lib/freshness.ts determines this. */
export type LampState =
  | 'ok'
  | 'watch'
  | 'warning'
  | 'critical'
  | 'progress'
  | 'unknown'
  | 'stale'
  | 'unreported'
  | 'never'
  | 'off'
  | 'override';

const COLOURS: Record<LampState, string> = {
  ok: 'var(--ok)',
  watch: 'var(--watch)',
  warning: 'var(--warn)',
  critical: 'var(--crit)',
  progress: 'var(--ac)',
  unknown: 'var(--unk)',
  stale: 'var(--unk)',
  unreported: 'var(--tx3)',
  never: 'var(--tx3)',
  off: 'var(--tx3)',
  override: 'var(--tx1)',
};

export function lampColour(state: LampState): string {
  return COLOURS[state];
}

export function lampOf(state: string | null | undefined): LampState {
  return state && state in COLOURS ? (state as LampState) : state === 'none' || !state ? 'never' : 'unknown';
}
