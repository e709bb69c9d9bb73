/** Of several questions only the newest is answered: an old answer that comes late would stand under the new question. */
export class Newest {
  private turn = 0;

  /** Nothing that was asked is wanted any more. */
  forget(): void {
    this.turn += 1;
  }

  async ask<R>(question: Promise<R>, take: (answer: R) => void, failed: (error: unknown) => void = () => undefined): Promise<void> {
    const mine = ++this.turn;
    try {
      const answer = await question;
      if (mine === this.turn) take(answer);
    } catch (error) {
      if (mine === this.turn) failed(error);
    }
  }
}
