import type { LampState } from '../lib/lamp';

export interface Toast { key: number; state: LampState; text: string; id: string }
export const toasts = $state<{ list: Toast[] }>({ list: [] });
const SHOWN_MS = 9000;
let next = 1;

export function toast(state: LampState, text: string, id = ''): void {
  const key = next++;
  toasts.list = [...toasts.list.slice(-3), { key, state, text, id }];
  setTimeout(() => dismiss(key), SHOWN_MS);
}

export function dismiss(key: number): void {
  toasts.list = toasts.list.filter((t) => t.key !== key);
}
