/**
 * The one-time token of a URL. The server checks it when the page opens, so that an expired link is reported before the
 * user types a password.
 */
import { api, ApiError } from '../api/client';
import type { Problem } from '../api/types';

export class OneTimeLink {
  readonly token = location.hash.slice(1);
  invalid = $state<Problem | null>(null);

  constructor(kind: 'setup' | 'password') {
    if (this.token)
      void api.checkLink(kind, this.token).catch((error: unknown) => {
        if (error instanceof ApiError && error.status === 403) this.invalid = error.problem;
      });
  }
}
