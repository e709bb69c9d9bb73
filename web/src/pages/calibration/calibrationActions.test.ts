import { readFileSync } from 'node:fs';
import { expect, test } from 'vitest';

test('every button that changes something states the permission that it needs', () => {
  const file = readFileSync(new URL('CalibrationActions.svelte', import.meta.url), 'utf8');
  const buttons = file.match(/<button[^]*?<\/button/g) ?? [];
  const changing = buttons.filter((button) => button.includes('void run('));
  expect(changing.length).toBeGreaterThan(2);
  for (const button of changing) expect(button).toContain("needsPermission('calibrate')");
});
