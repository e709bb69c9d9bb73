import { beforeEach, expect, test, vi } from 'vitest';
import { FrameView } from './frame.svelte';

const { api, rawPixels } = vi.hoisted(() => ({ api: { frame: vi.fn(), histogram: vi.fn() }, rawPixels: vi.fn() }));
vi.mock('../api/client', () => ({ api, ApiError: class extends Error {} }));
vi.mock('../api/pixels', () => ({ rawPixels }));
vi.mock('./live.svelte', () => ({ live: { latestDeviceFrame: null } }));
vi.mock('./view.svelte', () => ({ view: { theme: 'dark' } }));

const PIXELS = { columns: 1, rows: 1, bits: 8, pixels: new Uint8Array(1), offset: 0, scale: 1 };
const detailOf = (id: number): object => {
  const ground = { id: 10 * id, attitude: {} };
  return { id, sha256: `${id}`, rows_held: [], received: '2026-12-01T18:00:00Z', solutions: [ground], ground };
};

beforeEach(() => {
  api.frame.mockImplementation((id: number) => Promise.resolve(detailOf(id)));
  api.histogram.mockResolvedValue({ low: 0, high: 1 });
  rawPixels.mockResolvedValue(PIXELS);
});

test('a chosen frame that cannot be loaded is not shown as the previous one', async () => {
  const fv = new FrameView();
  await fv.load(2);
  expect([fv.detail?.id, fv.image, fv.solution?.id]).toEqual([2, PIXELS, 20]);
  api.frame.mockRejectedValue(new TypeError('Failed to fetch'));
  await fv.load(1);
  expect([fv.detail, fv.image, fv.histogram, fv.solution]).toEqual([null, null, null, null]);
  expect(fv.problem).not.toBe('');
  api.frame.mockResolvedValue(detailOf(2));
  await fv.load(2);
  expect([fv.detail?.id, fv.image, fv.problem]).toEqual([2, PIXELS, '']);
});

test('a frame whose pixels were removed shows its results and the reason', async () => {
  const fv = new FrameView();
  await fv.load(2);
  rawPixels.mockRejectedValue(new Error('The pixels were removed.'));
  await fv.load(1);
  expect([fv.detail?.id, fv.image, fv.solution?.id]).toEqual([1, null, 10]);
  expect(fv.problem).not.toBe('');
});
