/** The signed-in user: name, role, permissions; and what happens when the server rejects the session. */
import { base } from '../lib/base';
import { api, door } from '../api/client';
import type { SessionInfo } from '../api/types';
import { lacking } from '../lib/roles';

class Session {
  /** False until the server has reported for the first time whether the user is signed in. */
  known = $state(false);
  info = $state<SessionInfo | null>(null);
  /** Time at which the session ended; the page below keeps its state. */
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

  /** Why the role may not do it, as a sentence; empty if it may. */
  lacks(permission: string): string {
    return this.can(permission) || !this.signedIn ? '' : lacking(permission, this.role);
  }

  /** Why the role may send no command at all; each group of commands has a separate permission. */
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

  /** Query the session; reports a problem if the server does not answer. A response older than a sign-in is ignored. */
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

  /** Resolves when a user is signed in; rejected reads then continue, changes never do. */
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

  /** Reload the page: no data of this user stays in memory. */
  async signOut(): Promise<void> {
    await api.signOut();
    location.assign(`${base}/live`);
  }

  /**
   * The server answered 401, possibly for a request older than the present session: query whether the session is over.
   */
  refused(): Promise<void> {
    return this.read();
  }
}

export const session = new Session();
door.refused = () => session.refused();
door.back = () => session.back();
