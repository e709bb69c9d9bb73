/** Check of typed frame numbers against the stored frames, before a request with them is sent. */
import { writeIds } from '../../lib/idlist';

export interface Listed {
  id: number;
  complete: boolean;
}
interface ListPage {
  total: number;
  frames: readonly Listed[];
}
export const PAGE_SIZE = 500;
const MAX_PAGES = 4;

/**
 * Return why some frames of the list cannot be used, "" if none is known. `read` returns a page of the stored frames.
 * At most 2000 frames are read; nothing is stated about others.
 */
export async function unusable(ids: readonly number[], read: (offset: number) => Promise<ListPage>): Promise<string> {
  const stored = new Map<number, boolean>();
  const missing = (): number[] => ids.filter((id) => !stored.has(id));
  let isComplete = false;
  for (let page = 0; page < MAX_PAGES && !isComplete && missing().length; page++) {
    const { total, frames } = await read(page * PAGE_SIZE);
    for (const f of frames) stored.set(f.id, f.complete);
    isComplete = frames.length === 0 || (page + 1) * PAGE_SIZE >= total;
  }
  const partial = ids.filter((id) => stored.get(id) === false);
  if (partial.length) {
    const these = partial.length > 1 ? 'these frames' : 'this frame';
    return `Rows are missing in ${listed(partial)}. Download the missing rows, or remove ${these} from the list.`;
  }
  return isComplete && missing().length ? `Not stored: ${listed(missing())}.` : '';
}

function listed(ids: readonly number[]): string {
  return `frame${ids.length > 1 ? 's' : ''} ${writeIds(ids)}`;
}
