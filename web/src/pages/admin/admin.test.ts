import { expect, it } from 'vitest';
import { auditAction, auditTarget, confirmationOf } from './admin';

it('confirms exactly what the preview showed, as of its time', () => {
  const counts = { at: '2026-12-01T18:00:00.000Z', frames: 3, frames_bytes: 1500, packets: 200, to_thin: 7, events: 9 };
  expect(confirmationOf({ ...counts, unusual: '3 of 4 frames with pixels (75 %)' })).toEqual(counts);
});

it('writes audit rows in words instead of requests', () => {
  expect(auditAction('commands.send_command')).toBe('commands: send command');
  expect(auditTarget('PUT /users/3')).toBe('users 3');
  expect(auditTarget('POST /campaigns/experiments')).toBe('campaigns experiments');
  expect(auditTarget('ann as admin')).toBe('ann as admin');
});
