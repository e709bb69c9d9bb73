/** The entry that the address of a page names, if the loaded list does not contain it. */
import { LatestRequest } from '../lib/latestRequest';
import { problemText } from '../lib/problems';

export class NamedRow<R> {
  row = $state.raw<R | null>(null);
  /** Why there is no entry; empty while it is loaded. */
  problem = $state('');
  private readonly reading = new LatestRequest();

  /** `read`: return the entry with an id, null if it belongs to another page. */
  constructor(private readonly read: (id: number) => Promise<R | null>) {}

  /** Load the entry with this id. Nothing is loaded without an id. */
  look(id: string): void {
    this.reading.discard();
    [this.row, this.problem] = [null, ''];
    const missing = `This page has no entry ${id}. Select another one.`;
    if (id && !Number.isSafeInteger(Number(id))) this.problem = missing;
    else if (id)
      void this.reading.run(
        this.read(Number(id)),
        (row) => ([this.row, this.problem] = [row, row ? '' : missing]),
        (error) => (this.problem = problemText(error)),
      );
  }
}
