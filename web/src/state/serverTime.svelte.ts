/**
 * The server's time for all parts of a page. It ticks at each full second, so that all counters are drawn together, and
 * pauses while the tab is hidden.
 */
import { live } from './live.svelte';

const SECOND_MS = 1000;

class ServerTime {
  nowMs = $state(Date.now());

  /** Start the ticks. Call it once when the page starts. */
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
