/**
 * The server's time, for all parts of a page: one tick at each full second, so that everything that counts seconds is
 * drawn together. It rests while the tab is hidden.
 */
import { live } from './live.svelte';

const SECOND_MS = 1000;

class ServerTime {
  nowMs = $state(Date.now());

  /** Call once when the page starts. */
  start(): void {
    document.addEventListener('visibilitychange', () => this.read());
    const tick = (): void => {
      this.read();
      setTimeout(tick, SECOND_MS - ((Date.now() + live.clockSkewMs) % SECOND_MS));
    };
    tick();
  }

  private read(): void {
    if (!document.hidden) this.nowMs = Date.now() + live.clockSkewMs;
  }
}

export const serverTime = new ServerTime();
