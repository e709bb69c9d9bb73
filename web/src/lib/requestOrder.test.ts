import { describe, expect, it } from 'vitest';
import { RequestOrder } from './requestOrder';

const after = <R>(ms: number, value: R): Promise<R> => new Promise((done) => setTimeout(() => done(value), ms));

describe('requests in order', () => {
  it('start after the response to the one before', async () => {
    const [order, events] = [new RequestOrder(), [] as string[]];
    const send = (name: string, ms: number) => async () => {
      events.push(`${name} sent`);
      events.push(await after(ms, `${name} answered`));
    };
    await Promise.all([order.run(send('first', 20)), order.run(send('second', 1))]);
    expect(events).toEqual(['first sent', 'first answered', 'second sent', 'second answered']);
  });
  it('continue after a failure, which only its own caller receives', async () => {
    const order = new RequestOrder();
    const failed = order.run(() => Promise.reject(new Error('no')));
    const sent = order.run(() => after(1, 'sent'));
    await expect(failed).rejects.toThrow('no');
    expect(await sent).toBe('sent');
  });
});
