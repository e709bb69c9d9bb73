/**
 * The one-time part of a URL, and whether the server still accepts it: an expired link is reported before the user
 * types anything.
 */
import { api, ApiError } from '../api/client';
import type { Problem } from '../api/types';

export class OneTimeLink {
  readonly token = location.hash.slice(1);
  over = $state<Problem | null>(null);

  constructor(kind: 'setup' | 'password') {
    if (this.token)
      void api.checkLink(kind, this.token).catch((error: unknown) => {
        if (error instanceof ApiError && error.status === 403) this.over = error.problem;
      });
  }
}
