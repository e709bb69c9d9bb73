import { describe, expect, it } from 'vitest';
import { noCancel } from './cancel';

const BUILD = { user: 'cara', permission: 'catalogues.build' };
const having =
  (...held: string[]) =>
  (permission: string): string =>
    held.includes(permission) ? '' : `needs ${permission}`;

describe('cancelling a job', () => {
  it('is refused to users who may not start its kind', () => {
    expect(noCancel(BUILD, 'olaf', having('jobs.cancel', 'campaigns'))).toBe('needs catalogues.build');
  });
  it('is allowed for the user who started it and for users who may start its kind', () => {
    expect(noCancel(BUILD, 'cara', having('jobs.cancel'))).toBe('');
    expect(noCancel(BUILD, 'mona', having('jobs.cancel', 'catalogues.build'))).toBe('');
  });
  it('always needs the permission to cancel; a job without a user belongs to no user', () => {
    expect(noCancel(BUILD, 'cara', having())).toBe('needs jobs.cancel');
    expect(noCancel({ user: '', permission: 'admin.backup' }, '', having('jobs.cancel'))).toBe('needs admin.backup');
  });
});
