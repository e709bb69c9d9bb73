import { describe, expect, it } from 'vitest';
import { RequestOrder } from './requestOrder';

const after = <R>(ms: number, value: R): Promise<R> => new Promise((done) => setTimeout(() => done(value), ms));

describe('requests in order', () => {
  it('start after the response to the previous one', async () => {
    const [order, events] = [new RequestOrder(), [] as string[]];
    const send = (name: string, ms: number) => async () => {
      events.push(`${name} sent`);
      events.push(await after(ms, `${name} answered`));
    };
    await Promise.all([order.run('first', send('first', 20)), order.run('second', send('second', 1))]);
    expect(events).toEqual(['first sent', 'first answered', 'second sent', 'second answered']);
  });
  it('continue after a failure, which only its own caller receives', async () => {
    const order = new RequestOrder();
    const failed = order.run('failed', () => Promise.reject(new Error('no')));
    const sent = order.run('sent', () => after(1, 'sent'));
    await expect(failed).rejects.toThrow('no');
    expect(await sent).toBe('sent');
  });
  it('are not sent if they wait when ABORT is pressed', async () => {
    const [order, started] = [new RequestOrder(), [] as string[]];
    const send = (name: string) => () => {
      started.push(name);
      return after(5, name);
    };
    const first = order.run('first', send('first'));
    await after(1, null);
    const waiting = order.run('waiting', send('waiting'));
    order.cancel('ABORT was pressed');
    const later = order.run('later', send('later'));
    await expect(waiting).rejects.toThrow('waiting was not sent: ABORT was pressed');
    expect([await first, await later]).toEqual(['first', 'later']);
    expect(started).toEqual(['first', 'later']);
  });
  it('are not sent after they waited for 10 s', async () => {
    let nowMs = 0;
    const order = new RequestOrder(() => nowMs);
    const first = order.run('first', () => after(5, 'first'));
    const late = order.run('late', () => after(1, 'late'));
    await after(1, null);
    nowMs = 10_001;
    expect(await first).toBe('first');
    await expect(late).rejects.toThrow('late was not sent: the server did not answer');
    expect(await order.run('next', () => after(1, 'next'))).toBe('next');
  });
});
