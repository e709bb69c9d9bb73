/** Identification of a chain as text in the URL, and as parameters of the report request. */
import type { ChainRecord } from '../../api/types';

type Key = Pick<ChainRecord, 'chain' | 'version' | 'options'>;

const SEPARATOR = '~';

export const keyOf = (c: Key): string => [c.chain, c.version, c.options].join(SEPARATOR);

export function keyFrom(text: string): Key | null {
  const [chain, version, ...options] = text.split(SEPARATOR);
  return chain && version ? { chain, version, options: options.join(SEPARATOR) } : null;
}

/**
 * Return the parameters of a chain's report, compared with another chain or, if null, with the operational ground
 * result.
 */
export function pairOf(mine: Key, against: Key | null): Record<string, string> & Key {
  const { chain, version, options } = mine;
  const other = against && {
    against_chain: against.chain,
    against_version: against.version,
    against_options: against.options,
  };
  return { chain, version, options, ...other };
}

/** Parse changed constants from "NAME=VALUE, …"; null if the text is invalid. */
export function optionsFrom(text: string): Record<string, string> | null {
  const out: Record<string, string> = {};
  for (const part of text.split(/[,;]\s+|\s+/).filter(Boolean)) {
    const at = part.indexOf('=');
    if (at < 1 || at === part.length - 1) return null;
    out[part.slice(0, at)] = part.slice(at + 1);
  }
  return out;
}
