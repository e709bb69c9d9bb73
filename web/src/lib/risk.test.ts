import { expect, test } from 'vitest';
import type { Check, CommandDefinition } from '../api/types';
import { needsConfirmation, riskOf } from './risk';

const OFF = { name: 'off', value: 0, hazard: 'warning', note: 'The unit loses its stored content' };
const ON = { name: 'on', value: 1, hazard: 'none', note: '' };
const power = {
  name: 'POWER',
  hazard: 'none',
  hazard_reason: '',
  arguments: [{ name: 'state', choices: [OFF, ON] }],
} as unknown as CommandDefinition;

test('a chosen value makes a command hazardous', () => {
  const off = riskOf(power, { state: 'off' }, null);
  expect(off).toMatchObject({ name: 'POWER', hazard: 'warning', hazard_reason: OFF.note });
  expect(needsConfirmation(off)).toBe(true);
  expect(needsConfirmation(riskOf(power, { state: 'on' }, null))).toBe(false);
});

test('a scheduled command is confirmed with its name', () => {
  const schedule = { ...power, name: 'SCHEDULE', hazard: 'watch', arguments: [] } as CommandDefinition;
  const check = { hazard: 'critical', hazard_reason: 'At execution: lost.', confirm_name: 'ERASE_BANK' } as Check;
  expect(riskOf(schedule, {}, check)).toMatchObject({ name: 'ERASE_BANK', hazard: 'critical' });
  expect(riskOf(schedule, {}, null)).toMatchObject({ name: 'SCHEDULE', hazard: 'watch' });
});
