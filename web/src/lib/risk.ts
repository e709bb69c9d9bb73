/** Hazard of a command with its values. */
import type { ArgumentValue, Check, CommandDefinition } from '../api/types';

/** `name`: the name to type as confirmation; for SCHEDULE that of the scheduled command. */
export type Risk = Pick<CommandDefinition, 'name' | 'hazard' | 'hazard_reason'>;
const RANK: readonly Risk['hazard'][] = ['none', 'watch', 'warning', 'critical'];

/** Return the highest hazard of a command, its chosen values and the dry run, which includes a scheduled command. */
export function riskOf(
  definition: CommandDefinition,
  values: Readonly<Record<string, ArgumentValue>>,
  check: Check | null,
): Risk {
  const { name } = definition;
  const chosen = definition.arguments.flatMap((a) =>
    a.choices
      .filter((c) => c.name === values[a.name])
      .map((c) => ({ name, hazard: c.hazard, hazard_reason: c.note || `${a.name} = ${c.name}` })),
  );
  const checked = check ? [{ ...check, name: check.confirm_name }] : [];
  return [...chosen, ...checked].reduce<Risk>(
    (worst, r) => (RANK.indexOf(r.hazard) > RANK.indexOf(worst.hazard) ? r : worst),
    definition,
  );
}

/** True if the operator must confirm the command or type its name. */
export function needsConfirmation(risk: Pick<Risk, 'hazard'>): boolean {
  return risk.hazard === 'warning' || risk.hazard === 'critical';
}
