/** Changing the constants of a chain for one run. */
import type { ChainOption } from '../../api/types';

/** Constants with a slider: those that an engineer tries first when stars are missing or false. */
export const SLIDERS: readonly string[] = ['threshold_dn', 'min_area_px', 'max_area_px'];

/** Range of a slider around the value for the camera; steps are whole numbers for integers. */
export function sliderOf(option: ChainOption): { least: number; most: number; step: number } {
  const value = Number(option.value);
  if (option.kind === 'integer') return { least: 1, most: Math.max(12, 4 * value), step: 1 };
  const step = 10 ** Math.floor(Math.log10(Math.max(value, 1e-6)) - 1);
  return { least: step, most: Math.max(4 * value, 10 * step), step };
}

/** The changes after one more: an empty text or the chain's own value takes the change back. */
export function withChange(
  changed: Readonly<Record<string, string>>,
  options: readonly ChainOption[],
  name: string,
  text: string,
): Record<string, string> {
  const rest = Object.fromEntries(Object.entries(changed).filter(([n]) => n !== name));
  const own = options.find((o) => o.name === name)?.value ?? '';
  return text === '' || text === own ? rest : { ...rest, [name]: text };
}
