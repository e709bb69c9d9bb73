/** Search for stars on the server while a user types in the palette. */
import { api } from '../api/client';
import type { StarSearchResult } from '../api/types';
import { LatestRequest } from '../lib/latestRequest';
import { problemText } from '../lib/problems';
import { noStarWords, starHits, type StarHit } from '../lib/starHits';

export interface StarSource {
  stars: (q: string, limit: number) => Promise<StarSearchResult>;
}
const MAX_STARS = 8;
const MAX_LETTERS = 60;
/** A single letter would match hundreds of stars. */
const MIN_LETTERS = 2;

export class StarSearch {
  private query = $state('');
  private result = $state.raw<StarSearchResult | null>(null);
  private problem = $state('');
  private readonly latest = new LatestRequest();

  constructor(
    private readonly source: StarSource,
    private readonly delayMs = 120,
  ) {}

  /** Search for a text after a pause in typing. An earlier search that has not returned is discarded. */
  search(text: string): void {
    this.latest.discard();
    this.query = text;
    this.result = null;
    this.problem = '';
    if (text.length < MIN_LETTERS || text.length > MAX_LETTERS || text.startsWith('#')) return;
    const answer = new Promise((resolve) => setTimeout(resolve, this.delayMs)).then(() =>
      this.query === text ? this.source.stars(text, MAX_STARS) : null,
    );
    void this.latest.run(
      answer,
      (result) => (this.result = result),
      (error) => (this.problem = problemText(error)),
    );
  }

  /** Return the stars that were found for this text; none if the search is for another text. */
  starsFor(text: string): StarHit[] {
    return text === this.query ? starHits(this.result?.stars ?? []) : [];
  }

  /** Return why no star is shown for this text. */
  wordsFor(text: string): string {
    if (text.length < MIN_LETTERS || text.length > MAX_LETTERS || text.startsWith('#')) return '';
    return noStarWords(text, text === this.query ? this.result : null, this.problem);
  }
}

export const starSearch = new StarSearch(api);
