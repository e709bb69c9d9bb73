import { describe, expect, it } from 'vitest';
import { done, news, STEPS, type Facts } from './tour';

const start: Facts = {
  connected: true,
  mine: false,
  other: '',
  commands: [],
  frames: 0,
  receivedShare: null,
  ground: false,
};
const ran = (
  name: string,
  values: Record<string, unknown> = {},
  result: Facts['commands'][number]['result'] = 'completed',
): Facts['commands'][number] => ({ name, result, detail: 'because', values }) as Facts['commands'][number];

describe('the tour', () => {
  it('advances by what the sensor did, in order', () => {
    expect(done(start)).toBe(0);
    const f: Facts = { ...start, mine: true };
    expect(done(f)).toBe(1);
    f.commands = [ran('TAKE_IMAGE')];
    expect(done(f)).toBe(1);
    expect(news(f)).toContain('downlink of the frame follows');
    f.frames = 1;
    expect(done(f)).toBe(2);
    f.commands = [ran('CALCULATE_ATTITUDE'), ...f.commands];
    expect(done(f)).toBe(2);
    f.commands = [ran('MATCH_STARS', { matched: 0 }), ran('FIND_CENTROIDS'), ran('TAKE_IMAGE')];
    expect(done(f)).toBe(3);
    expect(news(f)).toContain('No stars matched');
    f.commands = [
      ran('CALCULATE_ATTITUDE'),
      ran('MATCH_STARS', { matched: 9 }),
      ran('FIND_CENTROIDS'),
      ran('TAKE_IMAGE'),
    ];
    expect(done(f)).toBe(4);
    expect(news(f)).toContain('ground solution of the frame is in progress');
    expect(done({ ...f, ground: true })).toBe(STEPS.length);
  });
  it('counts an iteration as all of its steps', () => {
    expect(
      done({ ...start, mine: true, frames: 1, ground: true, commands: [ran('RUN_ITERATION', { matched: 12 })] }),
    ).toBe(STEPS.length);
  });
  it('reports what delays a step', () => {
    expect(news({ ...start, connected: false })).toContain('link is closed');
    expect(news({ ...start, other: 'ann' })).toContain('ann holds');
    expect(news({ ...start, mine: true, receivedShare: 0.4 })).toContain('40 %');
    expect(news({ ...start, mine: true, commands: [ran('TAKE_IMAGE', {}, 'rejected')] })).toContain(
      'rejected: because',
    );
  });
});
