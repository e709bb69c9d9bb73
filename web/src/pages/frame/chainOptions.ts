/** Changes of a chain's constants for one run. */
import type { ChainOption } from '../../api/types';

/** Constants with a slider: the first to change if stars are missing or false. */
export const SLIDERS: readonly string[] = ['threshold_dn', 'min_area_px', 'max_area_px'];

/** Return the range of a slider around the default value. Integers have whole steps. */
export function sliderOf(option: ChainOption): { min: number; max: number; step: number } {
  const value = Number(option.value);
  if (option.kind === 'integer') return { min: 1, max: Math.max(12, 4 * value), step: 1 };
  const step = 10 ** Math.floor(Math.log10(Math.max(value, 1e-6)) - 1);
  return { min: step, max: Math.max(4 * value, 10 * step), step };
}

/** Return the changes after another change. An empty text or the default value removes the change of this constant. */
export function withChange(
  changed: Readonly<Record<string, string>>,
  options: readonly ChainOption[],
  name: string,
  text: string,
): Record<string, string> {
  const others = Object.fromEntries(Object.entries(changed).filter(([n]) => n !== name));
  const defaultText = options.find((o) => o.name === name)?.value ?? '';
  return text === '' || text === defaultText ? others : { ...others, [name]: text };
}
