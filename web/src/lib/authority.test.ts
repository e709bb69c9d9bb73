import { describe, expect, it } from 'vitest';
import type { Authority } from '../api/types';
import { lossText, waitingOf, waitingText } from './authority';

const at = '2026-12-01T18:00:00Z';
const held = (holder: string | null, over: Partial<Authority> = {}): Authority => ({
  holder,
  since: at,
  mine: false,
  transfer: null,
  history: [],
  ...over,
});
const request = held('ann', { transfer: { kind: 'request', user: 'bob', note: 'pass begins', at } });
const offer = held('ann', { transfer: { kind: 'offer', user: 'bob', note: '', at } });
const ended = (ended_by: string, reason: string): Authority['history'] => [
  { holder: 'bob', taken: at, ended: null, ended_by: '', reason: '' },
  { holder: 'ann', taken: at, ended: at, ended_by, reason },
];

describe('hand-over of command authority', () => {
  it('requests an answer of the other side, and informs the side that waits', () => {
    expect(['ann', 'bob', 'cem'].map((me) => waitingOf(request, me))).toEqual(['answer', 'sent', 'none']);
    expect(['ann', 'bob', 'cem'].map((me) => waitingOf(offer, me))).toEqual(['sent', 'answer', 'none']);
    expect(waitingText(request, 'ann')).toBe('bob requested command authority at 18:00:00Z: pass begins');
    expect(waitingText(offer, 'ann')).toBe('You offered command authority to bob at 18:00:00Z.');
    expect(waitingText(held('ann'), 'ann')).toBe('');
  });
  it('alerts the user from whom another took authority, with the reason', () => {
    expect(lossText(true, held('bob', { history: ended('bob', 'ann left') }), 'ann')).toBe(
      'bob broke your command authority at 18:00:00Z: ann left. bob holds it now.',
    );
    expect(lossText(true, held('bob', { history: ended('bob', 'handed over to bob') }), 'ann')).toContain('accepted');
    expect(lossText(true, held(null), 'ann')).toBe('You lost command authority. No user holds it now.');
  });
  it('does not alert a user who gave it up, still holds it, or did not hold it', () => {
    expect(lossText(true, held('bob', { history: ended('ann', 'handed over to bob') }), 'ann')).toBe('');
    expect(lossText(true, held('ann'), 'ann')).toBe('');
    expect(lossText(false, held('bob', { history: ended('bob', 'x') }), 'ann')).toBe('');
  });
});
