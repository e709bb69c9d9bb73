/** Requests of shared views. */
import { body, http } from './http';
import type { ViewRequest } from './types';

const { GET, POST, PUT, DELETE } = http;

export const views = {
  views: () => body(GET('/api/views')),
  view: (view_id: number) => body(GET('/api/views/{view_id}', { params: { path: { view_id } } })),
  addView: (view: ViewRequest) => body(POST('/api/views', { body: view })),
  changeView: (view_id: number, version: number, view: ViewRequest) =>
    body(PUT('/api/views/{view_id}', { params: { path: { view_id } }, body: { ...view, version } })),
  dropView: (view_id: number) => body(DELETE('/api/views/{view_id}', { params: { path: { view_id } } })),
};
