import type { LampState } from '../lib/lamp';

export interface Toast {
  key: number;
  state: LampState;
  text: string;
  id: string;
}
export const toasts = $state<{ list: Toast[] }>({ list: [] });
const SHOWN_MS = 9000;
const MOST = 4;
let next = 1;

/** An error stays until it is closed; a success message disappears automatically. */
export function toast(state: LampState, text: string, id = ''): void {
  const key = next++;
  const again = toasts.list.filter((t) => t.text !== text || t.state !== state);
  const gone = again.length < MOST ? null : (again.find((t) => t.state !== 'critical') ?? again[0]);
  toasts.list = [...again.filter((t) => t !== gone), { key, state, text, id }];
  if (state !== 'critical') setTimeout(() => dismiss(key), SHOWN_MS);
}

export function dismiss(key: number): void {
  toasts.list = toasts.list.filter((t) => t.key !== key);
}
