import { describe, expect, it } from 'vitest';
import { LatestRequest } from './latestRequest';

const after = <R>(ms: number, value: R): Promise<R> => new Promise((done) => setTimeout(() => done(value), ms));

describe('the newest request', () => {
  it('is the only one answered, in whatever order the responses arrive', async () => {
    const [latest, taken] = [new LatestRequest(), [] as string[]];
    await Promise.all([
      latest.run(after(20, 'old'), (v) => taken.push(v)),
      latest.run(after(1, 'new'), (v) => taken.push(v)),
    ]);
    expect(taken).toEqual(['new']);
  });
  it('is not answered after it is discarded', async () => {
    const [latest, taken] = [new LatestRequest(), [] as string[]];
    const going = latest.run(after(1, 'late'), (v) => taken.push(v));
    latest.discard();
    await going;
    expect(taken).toEqual([]);
  });
  it('reports its failure, not that of an older one', async () => {
    const [latest, failed] = [new LatestRequest(), [] as unknown[]];
    const late = after(20, 0).then(() => Promise.reject(new Error('old')));
    await Promise.all([
      latest.run(
        late,
        () => undefined,
        (e) => failed.push(e),
      ),
      latest.run(
        Promise.reject(new Error('new')),
        () => undefined,
        (e) => failed.push((e as Error).message),
      ),
    ]);
    expect(failed).toEqual(['new']);
  });
});
