/**
 * Tour to the first attitude in five steps: what to press, what happens, and how the page detects that the step is
 * complete. Clicks are not counted.
 */
import type { Command } from '../../api/types';

export interface Facts {
  connected: boolean;
  /** True if the user holds command authority. */
  mine: boolean;
  /** Name of another user who holds command authority; empty if there is none. */
  other: string;
  /** Commands of the present contact, newest first. */
  commands: readonly Pick<Command, 'name' | 'result' | 'detail' | 'values'>[];
  /** Number of device frames stored on the ground. */
  frames: number;
  /** Received fraction of the frame being downlinked, 0 to 1; null if no frame is being downlinked. */
  receivedShare: number | null;
  /** True if the latest frame is solved on the ground. */
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
    press: 'Open “no user holds it” at the top right and press Take authority.',
    then: 'Only one user at a time can command the sensor. The header shows to all users who has authority.',
    target: 'authority-open',
  },
  {
    name: 'Image',
    press: 'Press Take image.',
    then: 'The sensor exposes a frame and downlinks it. It is shown above and solved automatically on the ground.',
    target: 'cmd-TAKE_IMAGE',
  },
  {
    name: 'Centroids',
    press: 'Press Centroids.',
    then: 'The sensor detects stars in its image. Crosses are centroids; dashed squares are rejected regions.',
    target: 'cmd-FIND_CENTROIDS',
  },
  {
    name: 'Match',
    press: 'Press Match.',
    then: 'The sensor identifies the stars with its active catalogue. Matched stars have green circles and names.',
    target: 'cmd-MATCH_STARS',
  },
  {
    name: 'Attitude',
    press: 'Press Attitude.',
    then: 'The sensor computes its attitude. It is shown beside the result of a different solver on the ground.',
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

/** Return the number of completed steps. A step counts only if all preceding steps are complete. */
export function done(f: Facts): number {
  const passed = [f.mine, f.frames > 0 && ran(f, 1), ran(f, 2), ran(f, 3), ran(f, 4) && f.ground];
  const first = passed.indexOf(false);
  return first < 0 ? STEPS.length : first;
}

/** Return the progress of the present step or the reason for its delay; empty while it waits for the user. */
export function news(f: Facts): string {
  const step = done(f);
  if (!f.connected) return 'The link is closed. Open it below first.';
  if (step === 0) return f.other ? `${f.other} holds command authority. Request it, or break it with a reason.` : '';
  if (step === 1 && f.receivedShare !== null) return `Downlinking the frame, ${Math.round(100 * f.receivedShare)} %.`;
  if (step === 1 && ran(f, 1)) return 'The image was exposed. The downlink of the frame follows.';
  if (step === 4 && ran(f, 4))
    return 'The sensor has computed its attitude. The ground solution of the frame is in progress.';
  const last = f.commands.find((c) => c.name === COMMANDS[step]);
  if (!last) return '';
  if (['rejected', 'failed', 'unknown'].includes(last.result))
    return `The last command was ${last.result}${last.detail ? `: ${last.detail}` : ''}. Press the button again.`;
  if (last.result !== 'completed') return `The command is ${last.result.replace(/_/g, ' ')} …`;
  return step === 3 ? 'No stars matched. Take another image and press Centroids first.' : '';
}
