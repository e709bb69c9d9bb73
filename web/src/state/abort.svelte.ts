/** The presses of ABORT on this page. They are kept in the session storage when the page is reloaded. */
import { unitStorageKey } from '../lib/base';
import { api } from '../api/client';
import { Presses } from '../lib/abort';
import type { Press } from '../lib/abortPress';
import { commandOrder } from '../lib/requestOrder';
import { live } from './live.svelte';
import { session } from './session.svelte';

const KEY = unitStorageKey('gss-abort');

class Abort {
  presses = $state.raw<readonly Press[]>([]);
  private readonly sender = new Presses({
    post: async (signal, serverStarted) => {
      const receipt = await api.abort(signal, serverStarted);
      if (receipt.command) live.putCommand(receipt.command);
      return receipt;
    },
    history: async (startMs, endMs, signal) => {
      if (!session.signedIn || session.endedAt !== null) throw new Error('not signed in');
      return api.findCommands(
        { name: ['ABORT'], start: new Date(startMs).toISOString(), end: new Date(endMs).toISOString() },
        signal,
      );
    },
    serverStarted: () => live.link?.server_started ?? null,
    online: () => live.online,
    probe: api.probe,
    now: () => Date.now() + live.clockSkewMs,
    user: () => session.name,
    later: (run, ms) => {
      const timer = setTimeout(run, ms);
      return () => clearTimeout(timer);
    },
    load: () => sessionStorage.getItem(KEY),
    save: (text) => sessionStorage.setItem(KEY, text),
    changed: (list) => {
      this.presses = list;
    },
  });

  /** Send ABORT immediately, without a confirmation. Commands of this page that have not been sent are cancelled. */
  send(): void {
    commandOrder.cancel('ABORT cancelled it');
    void this.sender.press();
  }

  reconcile(): void {
    this.sender.reconcile(live.commands);
  }

  check(): void {
    void this.sender.check();
  }

  acknowledge(): void {
    this.sender.acknowledge();
  }
}

export const abort = new Abort();
