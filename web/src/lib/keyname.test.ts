import { expect, it } from 'vitest';
import { nameInWords } from './arguments';
import { goToKey } from './keyname';

it('names the key as printed on the keyboard', () => {
  expect(goToKey('MacIntel')).toBe('⌘K');
  expect(goToKey('Linux x86_64')).toBe('Ctrl K');
  expect(goToKey('Win32')).toBe('Ctrl K');
});

it('writes an argument in words, with its unit only beside the value', () => {
  expect(nameInWords({ name: 'bit_error_rate', unit: '' })).toBe('Bit error rate');
  expect(nameInWords({ name: 'duration_s', unit: 's' })).toBe('Duration');
});
