import { describe, expect, it } from 'vitest';
import type { StarSearchResult } from '../api/types';
import { StarSearch } from '../state/starSearch.svelte';
import { noStarWords, starHits, withStars } from './starHits';

const star = (hip: number, name: string, exact = false, other_names: string[] = []) => ({
  ...{ hip, name, exact, other_names, ra_deg: 88.793, dec_deg: 7.407, v_mag: 0.45 },
});
const result = (...stars: ReturnType<typeof star>[]): StarSearchResult => ({
  stars,
  table_stars: 117_972,
  named_stars: 4536,
});
const page = (text: string) => ({ kind: 'page', text, note: '', hip: 0, exact: false });

describe('stars among the results', () => {
  it('have name, number, magnitude and position', () => {
    const note = (...of: Parameters<typeof star>) => starHits([star(...of)])[0]?.note;
    expect(note(27989, 'Betelgeuse')).toBe('HIP 27989, V 0.45, RA 88.79°, Dec +7.41°');
    expect(note(27989, 'Betelgeuse', true, ['α Ori', '58 Ori'])).toMatch(/^α Ori, 58 Ori, HIP 27989, V/);
    expect(note(5, 'HIP 5')).toBe('V 0.45, RA 88.79°, Dec +7.41°');
  });
  it('have a designation or number after a name that several of them have', () => {
    const stars = [star(110991, 'δ Cep', true, ['27 Cep']), star(110988, 'δ Cep', true), star(3, 'Vega')];
    expect(starHits(stars).map((hit) => hit.text)).toEqual(['δ Cep (27 Cep)', 'δ Cep (HIP 110988)', 'Vega']);
  });
  it('come first if exact, after a result of the same name, and last otherwise', () => {
    const stars = starHits([star(1, 'Vega', true), star(2, 'Vegas star')]);
    const texts = (hits: string[], limit = 9) =>
      withStars('vega', hits.map(page), stars, limit).map((h) => `${h.kind} ${h.text}`);
    expect(texts(['Vega', 'Vega 2'])).toEqual(['page Vega', 'star Vega', 'page Vega 2', 'star Vegas star']);
    expect(texts(['a', 'b', 'c'], 3)).toEqual(['star Vega', 'page a', 'star Vegas star']);
  });
  it('are explained if there is none', () => {
    expect(noStarWords('hip 999999', result(), '')).toMatch(/^HIP 999999 is not among the 117.972 stars/);
    expect(noStarWords('zzz', result(), '')).toMatch(/4.536 named stars/);
    expect(noStarWords('zzz', null, '')).toBe('Searching the star table …');
    expect(noStarWords('zzz', null, 'No answer.')).toBe('The stars could not be searched: No answer.');
  });
});

describe('the search for stars', () => {
  const wait = (): Promise<void> => new Promise((r) => setTimeout(r, 20));
  it('asks once for the last text and shows no stars of an earlier one', async () => {
    const sent: string[] = [];
    const search = new StarSearch(
      {
        stars: (q) => {
          sent.push(q);
          return Promise.resolve(result(star(1, q)));
        },
      },
      0,
    );
    search.search('ve');
    search.search('vega');
    await wait();
    expect(sent).toEqual(['vega']);
    expect(search.starsFor('vega').map((s) => s.text)).toEqual(['vega']);
    expect(search.starsFor('ve')).toEqual([]);
    search.search('#12');
    await wait();
    expect(sent).toEqual(['vega']);
    expect(search.wordsFor('#12')).toBe('');
  });
  it('states a failed search', async () => {
    const search = new StarSearch({ stars: () => Promise.reject(new Error('no connection')) }, 0);
    search.search('vega');
    await wait();
    expect(search.wordsFor('vega')).toContain('could not be searched');
  });
});
