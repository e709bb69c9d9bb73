import { describe, expect, it } from 'vitest';
import { commandText } from './commandText';

const DICTIONARY = [{ name: 'TAKE_IMAGE', code: 33 }];
const order = { at_s: 3359.801, command_code: 33, length: 3, payload: '000000' };

describe('arguments of a command', () => {
  it('name the command that is scheduled', () => {
    expect(commandText({ name: 'SCHEDULE', text: 'at 3359.801, command 33', arguments: order }, DICTIONARY)).toMatch(
      /^TAKE_IMAGE at device time 3.359\.8 s$/,
    );
  });
  it('stay unchanged for other commands and for bytes that the dictionary does not define', () => {
    expect(
      commandText({ name: 'SET_EXPOSURE', text: 'exposure 250', arguments: { exposure_ms: 250 } }, DICTIONARY),
    ).toBe('exposure 250');
    expect(
      commandText({ name: 'SCHEDULE', text: 'at 1, command 9', arguments: { ...order, command_code: 9 } }, DICTIONARY),
    ).toBe('at 1, command 9');
  });
});
