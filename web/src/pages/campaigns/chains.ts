/** A chain of the comparison as text in the URL, and as the parameters of its report. */
import type { ChainRecord } from '../../api/types';

type Key = Pick<ChainRecord, 'chain' | 'version' | 'options'>;

const BETWEEN = '~';

export const keyOf = (c: Key): string => [c.chain, c.version, c.options].join(BETWEEN);

export function keyFrom(text: string): Key | null {
  const [chain, version, ...options] = text.split(BETWEEN);
  return chain && version ? { chain, version, options: options.join(BETWEEN) } : null;
}

/** Parameters of the report of one chain against another; without it against the operational ground result. */
export function pairOf(mine: Key, against: Key | null): Record<string, string> & Key {
  const { chain, version, options } = mine;
  const other = against && {
    against_chain: against.chain,
    against_version: against.version,
    against_options: against.options,
  };
  return { chain, version, options, ...other };
}

/** Changed constants as a request takes them, from "NAME=VALUE, …"; null: unreadable. */
export function optionsFrom(text: string): Record<string, string> | null {
  const out: Record<string, string> = {};
  for (const part of text.split(/[,;]\s+|\s+/).filter(Boolean)) {
    const at = part.indexOf('=');
    if (at < 1 || at === part.length - 1) return null;
    out[part.slice(0, at)] = part.slice(at + 1);
  }
  return out;
}
