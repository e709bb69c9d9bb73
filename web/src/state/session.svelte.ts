/** The session: user name, role and permissions, and the reaction to an ended session. */
import { base } from '../lib/base';
import { api, sessionHooks } from '../api/client';
import type { SessionInfo } from '../api/types';
import { commandOrder } from '../lib/requestOrder';
import { lacking } from '../lib/roles';

class Session {
  /** True after the server's first report of the session. */
  loaded = $state(false);
  info = $state<SessionInfo | null>(null);
  /** Time at which the session ended; null if it has not ended. The page keeps its state below the sign-in form. */
  endedAt = $state<number | null>(null);
  problem = $state('');
  private waiting: (() => void)[] = [];
  private generation = 0;

  readonly signedIn = $derived(this.info?.signed_in ?? false);
  readonly name = $derived(this.info?.name ?? '');
  readonly role = $derived(this.info?.role ?? '');
  readonly csrf = $derived(this.info?.csrf ?? '');
  private readonly permissions = $derived(new Set(this.info?.permissions ?? []));

  can(permission: string): boolean {
    return this.permissions.has(permission);
  }

  /** Return why the role does not have the permission; empty if it does. */
  permissionProblem(permission: string): string {
    return this.can(permission) || !this.signedIn ? '' : lacking(permission, this.role);
  }

  /**
   * Return why the role cannot send any command; empty if it can send some. Each group of commands has a separate
   * permission.
   */
  commandingProblem(): string {
    return [...this.permissions].some((p) => p.startsWith('command.'))
      ? ''
      : this.permissionProblem('command.attitude');
  }

  put(info: SessionInfo): void {
    this.loaded = true;
    this.problem = '';
    if (info.signed_in) {
      this.info = info;
      this.endedAt = null;
      sessionHooks.csrfToken = info.csrf;
      const resolvers = this.waiting;
      this.waiting = [];
      for (const resolve of resolvers) resolve();
    } else this.end(info);
  }

  private end(info: SessionInfo): void {
    commandOrder.cancel('your session ended');
    if (!this.info?.signed_in) this.info = info;
    else if (this.endedAt === null) this.endedAt = Date.now();
  }

  /**
   * Query the session. Sets `problem` if the server does not answer. A response that is older than a sign-in is
   * ignored.
   */
  async read(): Promise<void> {
    const own = this.generation;
    try {
      const info = await api.session();
      if (own === this.generation) this.put(info);
    } catch (error) {
      this.problem = error instanceof Error ? error.message : String(error);
    }
  }

  private enter(info: SessionInfo): void {
    this.generation += 1;
    this.put(info);
  }

  /** Wait until a user is signed in. Reads that the server rejected are then repeated; changes are not. */
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

  /** Sign out and reload the page, so that no data of this user stays in memory. */
  async signOut(): Promise<void> {
    await api.signOut();
    location.assign(`${base}/`);
  }

  /**
   * Query whether the session has ended. Called after a 401 response, which can belong to a request that is older than
   * the present session.
   */
  refused(): Promise<void> {
    return this.read();
  }
}

export const session = new Session();
sessionHooks.onUnauthorized = () => session.refused();
sessionHooks.signedIn = () => session.back();
