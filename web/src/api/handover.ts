/** Requests of checklists and hand-over notes. */
import { body, http } from './http';

const { GET, POST, PUT } = http;

export const handover = {
  checklist: () => body(GET('/api/checklist')),
  changeChecklist: (items: string[], version: number) => body(PUT('/api/checklist', { body: { items, version } })),
  handover: (contact_id: number) =>
    body(GET('/api/contacts/{contact_id}/handover', { params: { path: { contact_id } } })),
  checkItem: (contact_id: number, item: string, done: boolean) =>
    body(PUT('/api/contacts/{contact_id}/checklist', { params: { path: { contact_id } }, body: { item, done } })),
  addHandoverNote: (contact_id: number, text: string) =>
    body(POST('/api/contacts/{contact_id}/handover-notes', { params: { path: { contact_id } }, body: { text } })),
  unacknowledgedNotes: () => body(GET('/api/handover-notes')),
  acknowledgeHandoverNote: (note_id: number) =>
    body(POST('/api/handover-notes/{note_id}/acknowledge', { params: { path: { note_id } } })),
};
