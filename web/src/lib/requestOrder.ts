/**
 * Start each request after the response to the one before. Concurrent requests use several connections: the server can
 * receive them in another order, and a command would overtake one that was clicked earlier.
 */
export class RequestOrder {
  private last: Promise<unknown> = Promise.resolve();

  /** Run a request after all earlier ones, also if these failed. */
  run<R>(request: () => Promise<R>): Promise<R> {
    const response = this.last.then(request, request);
    this.last = response.catch(() => undefined);
    return response;
  }
}
