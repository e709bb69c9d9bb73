/**
 * Freshness of the indicators on this page: the rules of lib/freshness applied to the state of stream, server and line.
 */
import * as rules from '../lib/freshness';
import type { LampState } from '../lib/lamp';
import { live } from './live.svelte';
import { serverTime } from './serverTime.svelte';

class Current {
  readonly conditions = $derived.by<rules.Conditions>(() => {
    const link = live.link;
    const serverMs = link ? Date.parse(link.utc) : null;
    const ageS = link?.rx.age_s ?? null;
    return {
      nowMs: Math.max(serverTime.nowMs, serverMs ?? 0),
      online: live.online,
      serverMs,
      lineOpen: link?.connected ?? false,
      deviceMs: serverMs === null || ageS === null ? null : serverMs - ageS * 1000,
    };
  });
  readonly server = $derived(rules.freshnessOf('server', this.conditions));
  readonly device = $derived(rules.freshnessOf('device', this.conditions));
  readonly serverNote = $derived(rules.noteOf(this.server, this.conditions.serverMs, this.conditions.nowMs));
  /** Time of the latest housekeeping packet, which reports mode, cycle and active bank. */
  readonly housekeepingMs = $derived.by(() => {
    const at = live.byName.get('cycle_running')?.at ?? live.byName.get('mode')?.at;
    return at ? Date.parse(at) : this.conditions.deviceMs;
  });
  readonly housekeeping = $derived(rules.freshnessOf('device', this.conditions, this.housekeepingMs));
  readonly housekeepingNote = $derived(rules.noteOf(this.housekeeping, this.housekeepingMs, this.conditions.nowMs));
  readonly cycle = $derived.by(() => {
    const reported = live.byName.get('cycle_running')?.value;
    const last =
      reported === undefined
        ? live.link?.connected
          ? live.link.cycle_running
          : null
        : reported === null
          ? null
          : isTrue(reported);
    return rules.cycleOf(last, this.housekeepingMs, this.conditions);
  });

  isCurrent(source: 'server' | 'device'): boolean {
    return rules.isCurrent(source === 'server' ? this.server : this.device);
  }

  lamp(state: LampState, source: rules.LampSource): LampState {
    const effective = rules.sourceOf(state, source);
    return effective === 'server'
      ? rules.lampWhen(state, this.server)
      : effective === 'device'
        ? rules.lampWhen(state, this.device)
        : effective === 'housekeeping'
          ? rules.lampWhen(state, this.housekeeping)
          : state;
  }
}

/** Convert a boolean field of the API, which is a number or a text. */
function isTrue(value: string | number): boolean {
  return typeof value === 'number' ? value !== 0 : ['true', 'yes', 'on', '1'].includes(value.toLowerCase());
}

export const current = new Current();
