/** Details of the opened contact and the check of its record. Nothing of another contact is shown. */
import type { ContactDetail, ContactRecord } from '../../api/types';
import { Newest } from '../../lib/newest';
import { problemText } from '../../lib/problems';

export interface ContactSource {
  contact: (id: number) => Promise<ContactDetail>;
  contactRecord: (id: number) => Promise<ContactRecord>;
}

export class ContactReading {
  detail = $state.raw<ContactDetail | null>(null);
  record = $state.raw<ContactRecord | null>(null);
  private detailProblem = $state('');
  private recordProblem = $state('');
  readonly problem = $derived(this.detailProblem || this.recordProblem);
  private id: number | null = null;
  private readonly details = new Newest();
  private readonly records = new Newest();

  constructor(private readonly source: ContactSource) {}

  /** Forget the contact opened before, with its answers that have not arrived yet. */
  private turnTo(id: number): void {
    if (id === this.id) return;
    this.id = id;
    this.details.forget();
    this.records.forget();
    this.detail = null;
    this.record = null;
    this.detailProblem = '';
    this.recordProblem = '';
  }

  readDetail(id: number): Promise<void> {
    this.turnTo(id);
    return this.details.ask(
      this.source.contact(id),
      (found) => this.put(found),
      (e) => (this.detailProblem = problemText(e)),
    );
  }

  readRecord(id: number): Promise<void> {
    this.turnTo(id);
    return this.records.ask(
      this.source.contactRecord(id),
      (found) => {
        this.record = found;
        this.recordProblem = '';
      },
      (e) => (this.recordProblem = problemText(e)),
    );
  }

  /** Details that a change returned. Answers requested before it are older. */
  changed(found: ContactDetail): void {
    if (found.id !== this.id) return;
    this.details.forget();
    this.put(found);
  }

  private put(found: ContactDetail): void {
    this.detail = found;
    this.detailProblem = '';
  }
}
