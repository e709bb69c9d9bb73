/** Text in the procedure editor. It remains while the user visits another page of the console. */

class Draft {
  /** False: the editor is closed. */
  open = $state(false);
  /** Stored procedure that is edited; null for a new procedure. */
  id = $state<number | null>(null);
  text = $state('');
  /** Hash of the stored text that is edited. */
  sha256 = '';
  private first = $state('');

  get changed(): boolean {
    return this.open && this.text !== this.first;
  }

  edit(id: number | null, text: string, sha256 = ''): void {
    this.id = id;
    this.sha256 = sha256;
    this.text = this.first = text;
    this.open = true;
  }

  /** Close the editor without saving. */
  close(): void {
    this.open = false;
  }
}

export const draft = new Draft();
