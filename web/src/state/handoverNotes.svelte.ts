/** Hand-over notes of other users that are not acknowledged, for the sidebar and for the strip on Live and Contacts. */
import { api } from '../api/client';
import type { HandoverNote } from '../api/types';
import { LatestRequest } from '../lib/latestRequest';
import { attempt, live } from './live.svelte';

const READ_MS = 15_000;

class HandoverNotes {
  /** Notes of other users, oldest first. */
  others = $state.raw<readonly HandoverNote[]>([]);
  private readonly latest = new LatestRequest();

  /** Read the notes now and regularly while the server answers. Returns a function that ends it. */
  follow(): () => void {
    this.read();
    const timer = setInterval(() => this.read(), READ_MS);
    return () => clearInterval(timer);
  }

  async acknowledge(id: number): Promise<void> {
    this.latest.discard();
    await attempt(() => api.acknowledgeHandoverNote(id));
    this.read();
  }

  private read(): void {
    if (!live.online) return;
    void this.latest.run(
      api.unacknowledgedNotes(),
      (notes) => (this.others = notes),
      () => undefined,
    );
  }
}

export const handoverNotes = new HandoverNotes();
