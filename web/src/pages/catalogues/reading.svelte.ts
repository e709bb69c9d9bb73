/** Catalogue on the star map. A response or an error about a catalogue that was chosen before is never shown. */
import type { CatalogueDetail } from '../../api/types';
import { LatestRequest } from '../../lib/latestRequest';
import { problemText } from '../../lib/problems';

export class CatalogueReading {
  detail = $state.raw<CatalogueDetail | null>(null);
  problem = $state('');
  private readonly latest = new LatestRequest();

  constructor(private readonly source: { catalogue: (id: number) => Promise<CatalogueDetail> }) {}

  read(id: number | undefined): Promise<void> {
    this.latest.discard();
    this.detail = null;
    this.problem = '';
    if (id === undefined) return Promise.resolve();
    return this.latest.run(
      this.source.catalogue(id),
      (response) => (this.detail = response),
      (error) => (this.problem = problemText(error)),
    );
  }
}
