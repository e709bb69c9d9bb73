/** Details of the opened contact and the check of its record. Data of a previously opened contact is never shown. */
import type { ContactDetail, ContactRecord } from '../../api/types';
import { LatestRequest } from '../../lib/latestRequest';
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
  private readonly details = new LatestRequest();
  private readonly records = new LatestRequest();

  constructor(private readonly source: ContactSource) {}

  /** Change to another contact: discard the previous data and outstanding responses. */
  private switchTo(id: number): void {
    if (id === this.id) return;
    this.id = id;
    this.details.discard();
    this.records.discard();
    this.detail = null;
    this.record = null;
    this.detailProblem = '';
    this.recordProblem = '';
  }

  readDetail(id: number): Promise<void> {
    this.switchTo(id);
    return this.details.run(
      this.source.contact(id),
      (response) => this.put(response),
      (e) => (this.detailProblem = problemText(e)),
    );
  }

  readRecord(id: number): Promise<void> {
    this.switchTo(id);
    return this.records.run(
      this.source.contactRecord(id),
      (response) => {
        this.record = response;
        this.recordProblem = '';
      },
      (e) => (this.recordProblem = problemText(e)),
    );
  }

  /** Store the details that a change returned. Responses requested before it are discarded, because they are older. */
  changed(response: ContactDetail): void {
    if (response.id !== this.id) return;
    this.details.discard();
    this.put(response);
  }

  private put(response: ContactDetail): void {
    this.detail = response;
    this.detailProblem = '';
  }
}
