/** Changes of a chain's constants for one run. */
import type { ChainOption } from '../../api/types';

/** Constants with a slider. They are the first ones to change if stars are missed or false stars are detected. */
export const SLIDERS: readonly string[] = ['threshold_dn', 'min_area_px', 'max_area_px'];

/** Return the range of a slider around the default value. Integers have whole steps. */
export function sliderOf(option: ChainOption): { min: number; max: number; step: number } {
  const value = Number(option.value);
  if (option.kind === 'integer') return { min: 1, max: Math.max(12, 4 * value), step: 1 };
  const step = 10 ** Math.floor(Math.log10(Math.max(value, 1e-6)) - 1);
  return { min: step, max: Math.max(4 * value, 10 * step), step };
}

/**
 * Return the changed constants after `name` was set to `text`. A constant whose text is empty or the default value is
 * not included.
 */
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
