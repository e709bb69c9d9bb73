/** Telemetry parameters that a text names. */
const NAME = /[a-z_]\w*\.[a-z_]\w*/gi;

/** Return the parameters in `known`, as packet.field, that an expression or a condition names, each once. */
export function parametersIn(text: string, known: { has: (key: string) => boolean }): string[] {
  return [...new Set(text.match(NAME) ?? [])].filter((key) => known.has(key));
}
