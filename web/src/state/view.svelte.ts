/** What the person set on this screen: theme, overlays, freeze, keys of the page. */
export type Overlay = 'regions' | 'centroids' | 'matched' | 'predicted' | 'rejected' | 'residual' | 'grid';
export interface PageKey { key: string; text: string; run: () => void }

class View {
  theme = $state<'dark' | 'light'>(localStorage.getItem('gss-theme') === 'light' ? 'light' : 'dark');
  frozen = $state(false);
  help = $state(false);
  overlays = $state<Record<Overlay, boolean>>({ regions: true, centroids: true, matched: true, predicted: true, rejected: true, residual: false, grid: true });
  overlaysOff = $state(false);
  keys = $state<PageKey[]>([]);
  wide = $state(innerWidth >= 1400);

  setTheme(theme: 'dark' | 'light'): void {
    this.theme = theme;
    localStorage.setItem('gss-theme', theme);
    document.documentElement.dataset['theme'] = theme;
  }
}

export const view = new View();
