const WAIT_MS = 10_000;

/** A request that was not sent. Its text is shown as it is, without the name of a class. */
class NotSent extends Error {
  override toString(): string {
    return this.message;
  }
}

/**
 * Start each request after the response to the previous request. Concurrent requests use several connections: the
 * server can receive them in another order, and a command would overtake one that was clicked earlier. A request that
 * has waited for too long, or that was cancelled, is not sent.
 */
export class RequestOrder {
  private last: Promise<unknown> = Promise.resolve();
  private cancellations = 0;
  private reason = '';

  constructor(private readonly now: () => number = Date.now) {}

  /** Run a request after all earlier requests, even if they failed. `name`: shown if the request is not sent. */
  run<R>(name: string, request: () => Promise<R>): Promise<R> {
    const [cancellations, sinceMs] = [this.cancellations, this.now()];
    const start = (): Promise<R> => {
      if (cancellations !== this.cancellations) throw new NotSent(`${name} was not sent: ${this.reason}`);
      if (this.now() - sinceMs > WAIT_MS)
        throw new NotSent(`${name} was not sent: the server did not answer the previous command within 10 s`);
      return request();
    };
    const response = this.last.then(start);
    this.last = response.catch(() => undefined);
    return response;
  }

  /** Reject all requests that wait. A request that was sent is not affected. */
  cancel(reason: string): void {
    this.cancellations += 1;
    this.reason = reason;
  }
}

/** The commands of this page. ABORT is not one of them: it is sent immediately and cancels those that wait. */
export const commandOrder = new RequestOrder();
