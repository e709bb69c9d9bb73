/** State of the user interface: theme, overlays, freeze, window size and keys of the current page. */
import { untrack } from 'svelte';
import { themeOf, type Theme } from '../lib/theme';

export type Overlay = 'regions' | 'centroids' | 'matched' | 'predicted' | 'rejected' | 'residual' | 'grid';
export interface PageKey {
  key: string;
  text: string;
  run: () => void;
}
/** The panel that is open beside the page. */
export type Opened = 'none' | 'keys' | 'palette' | 'line';

const THEME_KEY = 'gss-theme';
const dark = matchMedia('(prefers-color-scheme: dark)');

class View {
  theme = $state<Theme>(themeOf(localStorage.getItem(THEME_KEY), dark.matches));
  frozen = $state(false);
  opened = $state<Opened>('none');
  overlays = $state<Record<Overlay, boolean>>({
    regions: true,
    centroids: true,
    matched: true,
    predicted: true,
    rejected: true,
    residual: false,
    grid: true,
  });
  overlaysOff = $state(false);
  keys = $state<PageKey[]>([]);
  offers = $state.raw<readonly (readonly PageKey[])[]>([]);
  wide = $state(innerWidth >= 1400);
  /** Wide enough for an additional column. */
  vast = $state(innerWidth >= 1700);
  /** Tablet width: the side columns are tabs. */
  narrow = $state(innerWidth < 1200);
  /** Pages flow in one column. */
  phone = $state(innerWidth < 600);
  readonly allKeys = $derived([...this.keys, ...this.offers.flat()]);
  /** The element that had the focus before a panel opened. It receives the focus again when the panel closes. */
  private before: HTMLElement | null = null;

  open(panel: Opened): void {
    if (this.opened === 'none' && document.activeElement instanceof HTMLElement) this.before = document.activeElement;
    this.opened = panel;
  }

  close(): void {
    this.opened = 'none';
    if (this.before?.isConnected) this.before.focus();
    this.before = null;
  }

  /** Show the theme, and follow the browser's colour scheme until the user chooses a theme. */
  followTheme(): void {
    const show = (): void => {
      this.theme = themeOf(localStorage.getItem(THEME_KEY), dark.matches);
      document.documentElement.dataset['theme'] = this.theme;
    };
    dark.addEventListener('change', show);
    show();
  }

  /** Store the theme that the user chose. */
  setTheme(theme: Theme): void {
    this.theme = theme;
    localStorage.setItem(THEME_KEY, theme);
    document.documentElement.dataset['theme'] = theme;
  }
}

export const view = new View();

/** Register the keys of a component while it is shown. Call this while the component is created. */
export function offerKeys(keys: () => readonly PageKey[]): void {
  $effect(() => {
    const offered = keys();
    untrack(() => (view.offers = [...view.offers, offered]));
    return () => {
      view.offers = view.offers.filter((o) => o !== offered);
    };
  });
}
