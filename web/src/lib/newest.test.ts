import { describe, expect, it } from 'vitest';
import { Newest } from './newest';

const after = <R>(ms: number, value: R): Promise<R> => new Promise((done) => setTimeout(() => done(value), ms));

describe('the newest question', () => {
  it('is the one that is answered, whichever answer comes last', async () => {
    const [asked, taken] = [new Newest(), [] as string[]];
    await Promise.all([asked.ask(after(20, 'old'), (v) => taken.push(v)), asked.ask(after(1, 'new'), (v) => taken.push(v))]);
    expect(taken).toEqual(['new']);
  });
  it('is not answered once it is forgotten', async () => {
    const [asked, taken] = [new Newest(), [] as string[]];
    const going = asked.ask(after(1, 'late'), (v) => taken.push(v));
    asked.forget();
    await going;
    expect(taken).toEqual([]);
  });
  it('tells its own failure, not that of an older one', async () => {
    const [asked, failed] = [new Newest(), [] as unknown[]];
    const late = after(20, 0).then(() => Promise.reject(new Error('old')));
    await Promise.all([asked.ask(late, () => undefined, (e) => failed.push(e)), asked.ask(Promise.reject(new Error('new')), () => undefined, (e) => failed.push((e as Error).message))]);
    expect(failed).toEqual(['new']);
  });
});
