/**
 * Use only the response to the latest of several requests. A late response to an earlier request must not replace the
 * response to a later one.
 */
export class LatestRequest {
  private generation = 0;

  /** Discard all outstanding requests. */
  discard(): void {
    this.generation += 1;
  }

  /** Pass the response, or the error, to the caller unless a later request has started. */
  async run<R>(
    request: Promise<R>,
    accept: (response: R) => void,
    failed: (error: unknown) => void = () => undefined,
  ): Promise<void> {
    const own = ++this.generation;
    try {
      const response = await request;
      if (own === this.generation) accept(response);
    } catch (error) {
      if (own === this.generation) failed(error);
    }
  }
}
