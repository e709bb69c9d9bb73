/** Who sits here: name, role, what the role may do; and what happens when the server no longer knows us. */
import { api, door } from '../api/client';
import type { SessionInfo } from '../api/types';
import { lacking } from '../lib/roles';

class Session {
  /** False until the server has said for the first time whether we are signed in. */
  known = $state(false);
  info = $state<SessionInfo | null>(null);
  /** Since when the session is over, after it once was there; the page below keeps its state. */
  endedAt = $state<number | null>(null);
  problem = $state('');
  private waiting: (() => void)[] = [];
  private turn = 0;

  readonly signedIn = $derived(this.info?.signed_in ?? false);
  readonly name = $derived(this.info?.name ?? '');
  readonly role = $derived(this.info?.role ?? '');
  readonly csrf = $derived(this.info?.csrf ?? '');
  private readonly permissions = $derived(new Set(this.info?.permissions ?? []));

  can(permission: string): boolean {
    return this.permissions.has(permission);
  }

  /** Why the role may not do it, as a sentence; empty when it may. */
  lacks(permission: string): string {
    return this.can(permission) || !this.signedIn ? '' : lacking(permission, this.role);
  }

  /** Why the role gives no command at all; each group of commands has a permission of its own. */
  lacksCommanding(): string {
    return [...this.permissions].some((p) => p.startsWith('command.')) ? '' : this.lacks('command.attitude');
  }

  put(info: SessionInfo): void {
    this.known = true;
    this.problem = '';
    if (info.signed_in) {
      this.info = info;
      this.endedAt = null;
      door.mark = info.csrf;
      const again = this.waiting;
      this.waiting = [];
      for (const run of again) run();
    } else this.over(info);
  }

  private over(info: SessionInfo): void {
    if (!this.info?.signed_in) this.info = info;
    else if (this.endedAt === null) this.endedAt = Date.now();
  }

  /** Asks the server; says what is wrong where it does not answer. An answer that somebody's signing in overtook says nothing. */
  async read(): Promise<void> {
    const turn = this.turn;
    try {
      const info = await api.session();
      if (turn === this.turn) this.put(info);
    } catch (error) {
      this.problem = error instanceof Error ? error.message : String(error);
    }
  }

  private enter(info: SessionInfo): void {
    this.turn += 1;
    this.put(info);
  }

  /** Settles when somebody is signed in; reads that were refused go on then, changes never do. */
  back(): Promise<void> {
    if (this.signedIn && this.endedAt === null) return Promise.resolve();
    return new Promise((resolve) => this.waiting.push(resolve));
  }

  async signIn(name: string, password: string): Promise<void> {
    this.enter(await api.signIn(name, password));
  }

  async setUp(token: string, name: string, password: string): Promise<void> {
    this.enter(await api.setUp(token, name, password));
  }

  async welcome(token: string, password: string): Promise<void> {
    this.enter(await api.welcome(token, password));
  }

  /** A fresh page: nothing of this person stays in memory. */
  async signOut(): Promise<void> {
    await api.signOut();
    location.assign('/live');
  }

  /** The server answered 401; that answer may be older than a new sign-in: it is asked whether the session is over. */
  refused(): Promise<void> {
    return this.read();
  }
}

export const session = new Session();
door.refused = () => session.refused();
door.back = () => session.back();
