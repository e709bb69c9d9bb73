/**
 * Five steps to the first attitude: what to press, what will happen, and the evidence that it happened. Clicks are not
 * counted.
 */
import type { Command } from '../../api/types';

export interface Facts {
  connected: boolean;
  /** The user holds command authority. */
  mine: boolean;
  /** Another user holds it. */
  other: string;
  /** Commands of the present contact, newest first. */
  commands: readonly Pick<Command, 'name' | 'result' | 'detail' | 'values'>[];
  /** Frames of the device that are stored on the ground. */
  frames: number;
  /** Received part of the frame being downlinked, 0 to 1; null if there is none. */
  coming: number | null;
  /** The ground has also solved the newest frame. */
  ground: boolean;
}

export interface Step {
  name: string;
  press: string;
  then: string;
  target: string;
}
export const STEPS: readonly Step[] = [
  {
    name: 'Authority',
    press: 'Open “no user holds it” at the top right and press Take it.',
    then: 'One person at a time commands a sensor; from now on it is you, and everybody sees it.',
    target: 'authority-open',
  },
  {
    name: 'Image',
    press: 'Press Take image.',
    then: 'The sensor exposes a frame of its sky and downlinks it. It appears above, and the ground solves it at once.',
    target: 'cmd-TAKE_IMAGE',
  },
  {
    name: 'Centroids',
    press: 'Press Centroids.',
    then: 'The sensor looks for stars in its image. Crosses are centroids, dashed squares are rejected regions.',
    target: 'cmd-FIND_CENTROIDS',
  },
  {
    name: 'Match',
    press: 'Press Match.',
    then: 'It names them with the catalogue of its active bank: green circles, names and magnitudes.',
    target: 'cmd-MATCH_STARS',
  },
  {
    name: 'Attitude',
    press: 'Press Attitude.',
    then: 'This is the sensor’s attitude, beside the ground’s with another solver and the difference in arcseconds.',
    target: 'cmd-CALCULATE_ATTITUDE',
  },
];
const COMMANDS = ['', 'TAKE_IMAGE', 'FIND_CENTROIDS', 'MATCH_STARS', 'CALCULATE_ATTITUDE'] as const;

function number(values: unknown, key: string): number | null {
  const v = (values as Record<string, unknown> | null)?.[key];
  return typeof v === 'number' ? v : null;
}

function ran(f: Facts, step: number): boolean {
  return f.commands.some(
    (c) =>
      (c.name === COMMANDS[step] || c.name === 'RUN_ITERATION') &&
      c.result === 'completed' &&
      !(step === 3 && number(c.values, 'matched') === 0),
  );
}

/** Number of completed steps, in order: a step counts only if those before it are complete. */
export function done(f: Facts): number {
  const passed = [f.mine, f.frames > 0 && ran(f, 1), ran(f, 2), ran(f, 3), ran(f, 4) && f.ground];
  const first = passed.indexOf(false);
  return first < 0 ? STEPS.length : first;
}

/** What delays the present step, or its progress; empty while it waits for the user. */
export function news(f: Facts): string {
  const step = done(f);
  if (!f.connected) return 'The link is closed: open it below first.';
  if (step === 0)
    return f.other ? `${f.other} holds command authority: ask for its release, or break it with a reason.` : '';
  if (step === 1 && f.coming !== null) return `The frame is coming down, ${Math.round(100 * f.coming)} %.`;
  if (step === 1 && ran(f, 1)) return 'The image is taken; its frame comes down next.';
  if (step === 4 && ran(f, 4)) return 'The sensor has its attitude; the ground is still solving the same frame.';
  const last = f.commands.find((c) => c.name === COMMANDS[step]);
  if (!last) return '';
  if (['rejected', 'failed', 'unknown'].includes(last.result))
    return `The last try was ${last.result}${last.detail ? `: ${last.detail}` : ''}. Press it again.`;
  if (last.result !== 'completed') return `It is ${last.result.replace(/_/g, ' ')} …`;
  return step === 3 ? 'No star was matched: take another image and find its centroids first.' : '';
}
