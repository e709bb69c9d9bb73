/** A job can be cancelled by the user who started it and by users with the permission to start such jobs. */
import type { Job } from '../api/types';

/**
 * Return the reason why this user cannot cancel the job; empty if allowed. `missing` returns the reason for a missing
 * permission, or an empty text.
 */
export function noCancel(
  job: Pick<Job, 'user' | 'permission'>,
  name: string,
  missing: (permission: string) => string,
): string {
  const isOwnJob = job.user === name && name !== '';
  return missing('jobs.cancel') || (isOwnJob ? '' : missing(job.permission));
}
