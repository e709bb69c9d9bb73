import { expect, it } from 'vitest';
import { ApiError } from '../api/client';
import { NamedRow } from './namedRow.svelte';

const problem = { id: '', message: 'No such job.', expected: '', got: '7', hint: '' };
const read = async (id: number): Promise<{ id: number } | null> => {
  if (id === 7) throw new ApiError(404, problem);
  return id === 8 ? null : { id };
};
const settled = (): Promise<void> => new Promise((done) => setTimeout(done));

it('an entry that is not in the list is loaded, and the reason is stated if it cannot be shown', async () => {
  const named = new NamedRow(read);
  const after = async (...ids: string[]): Promise<[number | undefined, string]> => {
    for (const id of ids) named.look(id);
    await settled();
    return [named.row?.id, named.problem];
  };
  expect(await after('5')).toEqual([5, '']);
  expect(await after('7')).toEqual([undefined, 'No such job. Got 7.']);
  expect(await after('8')).toEqual([undefined, 'This page has no entry 8. Select another one.']);
  expect(await after('<b>')).toEqual([undefined, 'This page has no entry <b>. Select another one.']);
  expect(await after('7', '5')).toEqual([5, '']);
  expect(await after('5', '')).toEqual([undefined, '']);
});
