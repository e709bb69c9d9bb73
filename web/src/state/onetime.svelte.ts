/** The one-time part of an address, and whether the server still takes it: a link that is over is told before anybody types. */
import { api, ApiError } from '../api/client';
import type { Problem } from '../api/types';

export class OneTimeLink {
  readonly token = location.hash.slice(1);
  over = $state<Problem | null>(null);

  constructor(kind: 'setup' | 'password') {
    if (this.token) void api.checkLink(kind, this.token).catch((error: unknown) => { if (error instanceof ApiError && error.status === 403) this.over = error.problem; });
  }
}
