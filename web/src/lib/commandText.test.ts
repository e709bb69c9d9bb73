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
  it('show the meaning of 0 that the dictionary states', () => {
    const definition = [
      {
        name: 'TAKE_IMAGE',
        code: 33,
        arguments: [
          { name: 'slot', unit: '', purpose: 'Image memory to fill' },
          { name: 'exposure_ms', unit: 'ms', purpose: 'Exposure time; 0 = value of SET_EXPOSURE' },
        ],
      },
    ] as unknown as Parameters<typeof commandText>[1];
    const taken = { name: 'TAKE_IMAGE', text: 'slot 0, exposure 0', arguments: { slot: 0, exposure_ms: 0 } };
    expect(commandText(taken, definition)).toBe('slot 0, exposure: value of SET_EXPOSURE');
    const other = { ...taken, text: 'slot 0, exposure 250', arguments: { slot: 0, exposure_ms: 250 } };
    expect(commandText(other, definition)).toBe('slot 0, exposure 250');
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
