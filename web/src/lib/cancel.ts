/** Who may end a job: who started it, and who may start its kind. */
import type { Job } from '../api/types';

/** Why this person may not cancel the job; empty where they may. `lacks` tells why a permission is missing. */
export function noCancel(job: Pick<Job, 'user' | 'permission'>, name: string, lacks: (permission: string) => string): string {
  const own = job.user === name && name !== '';
  return lacks('jobs.cancel') || (own ? '' : lacks(job.permission));
}
