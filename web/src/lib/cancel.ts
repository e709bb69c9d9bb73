/** Who may cancel a job: the user who started it, and users who may start its kind. */
import type { Job } from '../api/types';

/** Why this user may not cancel the job; empty if allowed. `lacks` states why a permission is missing. */
export function noCancel(
  job: Pick<Job, 'user' | 'permission'>,
  name: string,
  lacks: (permission: string) => string,
): string {
  const own = job.user === name && name !== '';
  return lacks('jobs.cancel') || (own ? '' : lacks(job.permission));
}
