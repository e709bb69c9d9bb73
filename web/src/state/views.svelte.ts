/** Shared views: pages with their state, stored on the server and opened by link. */
import { api } from '../api/client';
import type { View } from '../api/types';
import { unitStorageKey } from '../lib/base';
import { session } from './session.svelte';

/** A telemetry page that a user defined; the URL of the view contains its fields. */
export interface TelemetryView {
  view: View;
  fields: string[];
}
/** Storage key of the pages that earlier versions stored in the browser. */
const KEPT = unitStorageKey('gss-telemetry-pages');
export interface KeptPage {
  name: string;
  fields: string[];
  plot: string[];
}

export function telemetryPath(page: KeptPage): string {
  const q = new URLSearchParams({ own: page.name, fields: page.fields.join(','), plot: page.plot.join(',') });
  return `/telemetry?${q.toString()}`;
}

export function telemetryViews(list: readonly View[]): TelemetryView[] {
  return list
    .filter((view) => view.path.startsWith('/telemetry?'))
    .map((view) => ({ view, fields: (new URLSearchParams(view.path.slice(11)).get('fields') ?? '').split(',') }))
    .filter((own) => own.fields[0] !== '');
}

export function keptPages(text: string | null): KeptPage[] {
  try {
    const value: unknown = JSON.parse(text ?? '[]');
    return Array.isArray(value)
      ? value.filter(
          (p): p is KeptPage =>
            typeof p === 'object' &&
            p !== null &&
            typeof (p as KeptPage).name === 'string' &&
            Array.isArray((p as KeptPage).fields) &&
            Array.isArray((p as KeptPage).plot),
        )
      : [];
  } catch {
    return [];
  }
}

class Views {
  list = $state.raw<View[]>([]);

  async read(): Promise<void> {
    this.list = await api.views();
    if (!session.can('views')) return;
    const kept = keptPages(localStorage.getItem(KEPT));
    if (!kept.length) return;
    localStorage.removeItem(KEPT);
    for (const page of kept) await this.keep(page);
    this.list = await api.views();
  }

  /** Store a page under its name. If another view has this name, the user's name is added. */
  private async keep(page: KeptPage): Promise<void> {
    const taken = this.list.some((v) => v.name === page.name);
    const name = taken ? `${page.name} (${session.name})` : page.name;
    await api.addView({ name, path: telemetryPath({ ...page, name }), note: '', open: false }).catch(() => undefined);
  }

  /** Save a page as a view: a new view, or the next version of an existing view with this name. */
  async save(name: string, path: string): Promise<View> {
    const before = this.list.find((v) => v.name === name);
    const view = before
      ? await api.changeView(before.id, before.version, { name, path, note: before.note, open: before.open })
      : await api.addView({ name, path, note: '', open: false });
    await this.read();
    return view;
  }

  async drop(id: number): Promise<void> {
    await api.dropView(id);
    await this.read();
  }
}
export const views = new Views();
