import type { LampState } from '../lib/lamp';

export interface Toast {
  key: number;
  state: LampState;
  text: string;
  id: string;
}
export const toasts = $state<{ list: Toast[] }>({ list: [] });
const SHOWN_MS = 9000;
const MAX_TOASTS = 4;
let next = 1;

/** Show a message. Critical messages stay until they are closed; all others disappear after SHOWN_MS. */
export function toast(state: LampState, text: string, id = ''): void {
  const key = next++;
  const others = toasts.list.filter((t) => t.text !== text || t.state !== state);
  const dropped = others.length < MAX_TOASTS ? null : (others.find((t) => t.state !== 'critical') ?? others[0]);
  toasts.list = [...others.filter((t) => t !== dropped), { key, state, text, id }];
  if (state !== 'critical') setTimeout(() => dismiss(key), SHOWN_MS);
}

export function dismiss(key: number): void {
  toasts.list = toasts.list.filter((t) => t.key !== key);
}
