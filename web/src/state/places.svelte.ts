/** Entries of the palette: pages, commands, data of every kind, alarms, stars and help pages. */
import { api } from '../api/client';
import type { Catalogue, Contact, Frame, HelpPage } from '../api/types';
import { contentName } from '../lib/banks';
import { rank } from '../lib/rank';
import { withStars } from '../lib/starHits';
import { clock, day } from '../lib/format';
import { lampOf, type LampState } from '../lib/lamp';
import { PAGES } from './keys';
import { bare, keyOf, live } from './live.svelte';
import { go, route } from './router.svelte';
import { session } from './session.svelte';
import { starSearch } from './starSearch.svelte';
import { view } from './view.svelte';
import { views } from './views.svelte';

export interface Place {
  kind: string;
  text: string;
  note: string;
  state?: LampState;
  run: () => void;
}

const to = (path: string) => (): void => go(path);

class Places {
  frames = $state.raw<Frame[]>([]);
  catalogues = $state.raw<Catalogue[]>([]);
  contacts = $state.raw<Contact[]>([]);
  helpPages = $state.raw<HelpPage[]>([]);

  /** Load the entries that the stream does not report. Called each time the palette opens. */
  async read(): Promise<void> {
    await Promise.allSettled([
      api.frames({ limit: 50 }).then((p) => (this.frames = p.frames)),
      api.catalogues().then((c) => (this.catalogues = c)),
      api.contacts().then((c) => (this.contacts = c)),
      views.read(),
      this.helpPages.length ? undefined : api.helpPages().then((h) => (this.helpPages = h)),
    ]);
  }

  readonly all = $derived<Place[]>([
    ...PAGES.filter((p) => !p.permission || session.can(p.permission)).map((p) => ({
      kind: 'page',
      text: p.name,
      note: `g ${p.letter}`,
      run: to(p.path),
    })),
    { kind: 'page', text: 'Build a catalogue', note: 'Catalogues', run: to('/catalogues/new') },
    { kind: 'page', text: 'Design a camera', note: 'Catalogues', run: to('/catalogues/design') },
    { kind: 'page', text: 'Alarms', note: 'Telemetry, Monitor', run: to('/telemetry') },
    { kind: 'page', text: 'Import images', note: 'Frames', run: to('/frames') },
    { kind: 'page', text: 'Upload a catalogue', note: 'open one, then Upload', run: to('/catalogues') },
    { kind: 'page', text: 'Notifications', note: 'Admin', run: to('/admin?show=notifications') },
    { kind: 'page', text: 'Shared views', note: 'pages with their state', run: to('/views') },
    {
      kind: 'page',
      text: 'Save this page as a view',
      note: 'Shared views',
      run: () => go(`/views?save=${encodeURIComponent(route.path + route.search)}`),
    },
    ...views.list.map((v) => ({ kind: 'view', text: v.name, note: `by ${v.owner}`, run: to(v.path) })),
    { kind: 'page', text: 'Night analyses', note: 'Calibration', run: to('/calibration?tab=analyses') },
    ...live.alarms.map((a) => ({
      kind: 'alarm',
      text: a.title || a.field,
      note: a.limit_text || a.text,
      state: lampOf(a.level),
      run: to(`/telemetry?plot=${a.packet}.${a.field}`),
    })),
    ...(live.dictionary?.commands ?? []).map((c) => ({
      kind: 'command',
      text: c.name,
      note: c.purpose,
      run: to(`/commands?command=${c.name}`),
    })),
    ...live.commands.map((c) => ({
      kind: 'command',
      text: `#${c.request_id}`,
      note: `${c.name}, ${c.result}, ${day(c.created)} ${clock(c.created)}`,
      run: to(`/commands?id=${c.id}`),
    })),
    ...live.values.map((v) => ({
      kind: 'telemetry',
      text: v.title,
      note: `${bare(v)}, ${v.packet.replace(/_/g, ' ')}`,
      state: lampOf(v.state),
      run: to(`/telemetry?page=${encodeURIComponent(v.page)}&plot=${keyOf(v)}`),
    })),
    ...this.frames.map((f) => ({
      kind: 'frame',
      text: `Frame ${f.id}`,
      note: `${f.name ?? ''} ${day(f.taken)} ${clock(f.taken)}`,
      run: to(`/frames/${f.id}`),
    })),
    ...this.catalogues.map((c) => ({
      kind: 'catalogue',
      text: c.name || `catalogue ${c.id}`,
      note: `${c.stars} stars, ${day(c.created)}`,
      run: to(`/catalogues/${c.id}`),
    })),
    ...(live.link?.banks ?? []).map((b) => ({
      kind: 'bank',
      text: `Bank ${b.bank}`,
      note: `${contentName(b)}${b.active ? ', active' : ''}`,
      run: to(b.catalogue_id === null ? '/catalogues' : `/catalogues/${b.catalogue_id}`),
    })),
    ...this.contacts.map((c) => ({
      kind: 'contact',
      text: `Contact ${c.id}`,
      note: `${c.device} ${day(c.started)} ${clock(c.started)}`,
      run: to(`/contacts?contact=${c.id}`),
    })),
    { kind: 'help', text: 'All keys', note: '?', run: () => view.open('keys') },
    { kind: 'help', text: 'Tour: first attitude', note: 'five steps on Live', run: to('/live?tour=1') },
    {
      kind: 'help',
      text: 'Documentation',
      note: 'guides by role, reference',
      run: () => void window.open('/help', 'gss-help'),
    },
    ...this.helpPages.map((h) => ({
      kind: 'help',
      text: h.title,
      note: h.group,
      run: () => void window.open(`/help/${h.name}`, 'gss-help'),
    })),
    { kind: 'help', text: 'Command line', note: ':', run: () => view.open('line') },
    {
      kind: 'help',
      text: view.theme === 'dark' ? 'Light theme' : 'Dark theme',
      note: 'appearance',
      run: () => view.setTheme(view.theme === 'dark' ? 'light' : 'dark'),
    },
  ]);

  /**
   * Return the best entries for a query. A number up to the newest frame finds this frame first; #161 finds only
   * the command.
   * Stars are included when the server has returned them.
   */
  find(query: string, limit: number): Place[] {
    const text = query.trim();
    const request = /^#\d{1,15}$/.test(text) ? this.all.filter((p) => p.text === text) : [];
    if (request.length) return request;
    const stars = starSearch.starsFor(text).map((star) => ({ ...star, run: to(`/stars/${star.hip}`) }));
    const hits = rank(text, this.all, limit);
    if (!/^\d{1,15}$/.test(text)) return withStars(text, hits, stars, limit);
    const loaded = this.all.find((p) => p.text === `Frame ${text}`);
    const newest = Math.max(0, ...this.frames.map((f) => f.id));
    if (!loaded && Number(text) > newest) return withStars(text, hits, stars, limit);
    const frame = loaded ?? {
      kind: 'frame',
      text: `Frame ${text}`,
      note: 'by number',
      run: to(`/frames/${text}`),
    };
    const others = hits.filter((p) => p.text !== frame.text);
    return [frame, ...withStars(text, others, stars, limit - 1)];
  }
}

export const places = new Places();
