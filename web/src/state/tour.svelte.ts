/** The tour on this screen: shown by itself on an empty store with a simulated sensor, until it is closed; brought back from help. */
import { api } from '../api/client';
import { done, type Facts } from '../lib/tour';
import { live } from './live.svelte';
import { session } from './session.svelte';

const KEY = 'gss-tour';

class Tour {
  asked = $state(localStorage.getItem(KEY));
  empty = $state(false);
  private counted = $state({ frames: 0, ground: false });

  readonly shown = $derived(this.asked === 'open' || (this.asked === null && this.empty && (live.link?.simulated ?? false) && session.can('command.attitude')));
  private readonly mine = $derived(live.commands.filter((c) => c.contact_id === (live.link?.contact_id ?? null)));
  private readonly down = $derived(live.transfers.find((t) => t.direction === 'down' && t.finished === null) ?? null);
  readonly facts = $derived<Facts>({
    connected: live.link?.connected ?? false,
    mine: live.authority?.holder === session.name,
    other: live.authority?.holder && live.authority.holder !== session.name ? live.authority.holder : '',
    commands: this.mine,
    frames: this.counted.frames,
    coming: this.down ? this.down.stored_bytes / Math.max(1, this.down.size) : null,
    ground: this.counted.ground,
  });
  readonly step = $derived(done(this.facts));

  /** Asks what is stored; an empty store opens the tour, and once open it stays until it is closed. */
  async look(): Promise<void> {
    const page = await api.frames({ limit: 1, source: 'device' }).catch(() => null);
    if (!page) return;
    if (page.total === 0) this.empty = true;
    this.counted = { frames: page.total, ground: page.frames[0]?.outcome === 'solved' };
  }

  open(): void {
    this.asked = 'open';
    localStorage.setItem(KEY, 'open');
  }

  close(): void {
    this.asked = 'closed';
    localStorage.setItem(KEY, 'closed');
  }
}

export const tour = new Tour();
