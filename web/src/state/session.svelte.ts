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

  private over(info: SessionInfo | null): void {
    if (this.info?.signed_in && this.endedAt === null) this.endedAt = Date.now();
    if (this.info?.signed_in) return;
    this.info = info ?? this.info;
  }

  /** Asks the server; says what is wrong where it does not answer. */
  async read(): Promise<void> {
    try {
      this.put(await api.session());
    } catch (error) {
      this.problem = error instanceof Error ? error.message : String(error);
    }
  }

  /** Settles when somebody is signed in; reads that were refused go on then, changes never do. */
  back(): Promise<void> {
    if (this.signedIn && this.endedAt === null) return Promise.resolve();
    return new Promise((resolve) => this.waiting.push(resolve));
  }

  async signIn(name: string, password: string): Promise<void> {
    this.put(await api.signIn(name, password));
  }

  async setUp(token: string, name: string, password: string): Promise<void> {
    this.put(await api.setUp(token, name, password));
  }

  async welcome(token: string, password: string): Promise<void> {
    this.put(await api.welcome(token, password));
  }

  /** A fresh page: nothing of this person stays in memory. */
  async signOut(): Promise<void> {
    await api.signOut();
    location.assign('/live');
  }

  /** The server answered 401. */
  refused(): void {
    this.over(null);
  }
}

export const session = new Session();
door.refused = () => session.refused();
door.back = () => session.back();
