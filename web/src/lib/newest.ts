/**
 * Only the newest of several requests is answered: a late response to an older request must not be shown for the new
 * one.
 */
export class Newest {
  private turn = 0;

  /** Discard all outstanding requests. */
  forget(): void {
    this.turn += 1;
  }

  async ask<R>(
    question: Promise<R>,
    take: (answer: R) => void,
    failed: (error: unknown) => void = () => undefined,
  ): Promise<void> {
    const mine = ++this.turn;
    try {
      const answer = await question;
      if (mine === this.turn) take(answer);
    } catch (error) {
      if (mine === this.turn) failed(error);
    }
  }
}
