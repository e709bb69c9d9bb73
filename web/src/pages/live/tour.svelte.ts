/**
 * State of the tour. It opens automatically for an empty store with a simulated sensor, stays until it is closed, and
 * can be reopened from the help.
 */
import { api } from '../../api/client';
import { done, type Facts } from './tour';
import { live } from '../../state/live.svelte';
import { session } from '../../state/session.svelte';

const KEY = 'gss-tour';

class Tour {
  stored = $state(localStorage.getItem(KEY));
  empty = $state(false);
  private counted = $state({ frames: 0, ground: false });

  /** True if the sensor has the commands that the tour needs. */
  private readonly possible = $derived(live.dictionary?.commands.some((c) => c.name === 'TAKE_IMAGE') ?? false);

  readonly shown = $derived(
    this.stored === 'open' ||
      (this.stored === null &&
        this.empty &&
        (live.link?.simulated ?? false) &&
        this.possible &&
        session.can('command.attitude')),
  );
  private readonly contactCommands = $derived(
    live.commands.filter((c) => c.contact_id === (live.link?.contact_id ?? null)),
  );
  private readonly downlink = $derived(
    live.transfers.find((t) => t.direction === 'down' && t.finished === null) ?? null,
  );
  readonly facts = $derived<Facts>({
    connected: live.link?.connected ?? false,
    mine: live.authority?.holder === session.name,
    other: live.authority?.holder && live.authority.holder !== session.name ? live.authority.holder : '',
    commands: this.contactCommands,
    frames: this.counted.frames,
    receivedShare: this.downlink ? this.downlink.stored_bytes / Math.max(1, this.downlink.size) : null,
    ground: this.counted.ground,
  });
  readonly step = $derived(done(this.facts));

  /** Query the stored frames. An empty store opens the tour. */
  async refresh(): Promise<void> {
    const page = await api.frames({ limit: 1, source: 'device' }).catch(() => null);
    if (!page) return;
    if (page.total === 0) this.empty = true;
    this.counted = { frames: page.total, ground: page.frames[0]?.outcome === 'solved' };
  }

  open(): void {
    this.stored = 'open';
    localStorage.setItem(KEY, 'open');
  }

  close(): void {
    this.stored = 'closed';
    localStorage.setItem(KEY, 'closed');
  }
}

export const tour = new Tour();
