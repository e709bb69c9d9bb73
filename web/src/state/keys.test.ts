import { beforeEach, describe, expect, it, vi } from 'vitest';

/** The part of a browser that the keys need: elements that `closest` finds by the words of the selector. */
class FakeElement {
  isContentEditable = false;
  constructor(
    readonly tagName: string,
    private readonly marks: readonly string[] = [],
  ) {}
  closest(selector: string): FakeElement | null {
    return this.marks.some((mark) => selector.includes(mark)) ? this : null;
  }
}

function key(name: string, target: FakeElement, repeat = false) {
  const seen = { kept: false };
  return {
    seen,
    event: {
      key: name,
      target,
      repeat,
      ctrlKey: false,
      metaKey: false,
      altKey: false,
      shiftKey: false,
      preventDefault: () => {
        seen.kept = true;
      },
      stopPropagation: () => undefined,
    } as unknown as KeyboardEvent,
  };
}

async function keys() {
  const paths: string[] = [];
  vi.stubGlobal('Element', FakeElement);
  vi.stubGlobal('HTMLElement', FakeElement);
  vi.stubGlobal('sessionStorage', { getItem: () => null, setItem: () => undefined });
  vi.stubGlobal('localStorage', { getItem: () => null });
  vi.stubGlobal('location', { pathname: '/commands', search: '' });
  vi.stubGlobal('history', { pushState: (_: unknown, __: string, to: string) => paths.push(to) });
  vi.stubGlobal('innerWidth', 1440);
  vi.stubGlobal('matchMedia', () => ({ matches: true }));
  const { onKey } = await import('./keys');
  const { view } = await import('./view.svelte');
  const press = (name: string, target: FakeElement, repeat = false): boolean => {
    const { seen, event } = key(name, target, repeat);
    onKey(event);
    return seen.kept;
  };
  return { press, paths, view };
}

describe('Space after g', () => {
  const SENDS = new FakeElement('BUTTON', ['[data-sends]']);
  beforeEach(() => {
    vi.resetModules();
  });
  it('does not press a button that sends', async () => {
    const { press } = await keys();
    press('g', SENDS);
    expect(press(' ', SENDS)).toBe(true);
  });
  it('ends the wait for a page letter', async () => {
    const { press, paths } = await keys();
    press('g', SENDS);
    press(' ', SENDS);
    press('l', SENDS);
    expect(paths).toEqual([]);
  });
  it('does not affect g and a letter', async () => {
    const { press, paths } = await keys();
    press('g', SENDS);
    press('l', SENDS);
    expect(paths).toHaveLength(1);
  });
});

describe('a key that is held', () => {
  const BODY = new FakeElement('BODY');
  beforeEach(() => {
    vi.resetModules();
  });
  it('acts once, so that it does not act on items that were not seen', async () => {
    const { press, view } = await keys();
    const run = vi.fn();
    view.keys = [{ key: 'a', text: 'acknowledge', run }];
    press('a', BODY);
    press('a', BODY, true);
    press('a', BODY, true);
    expect(run).toHaveBeenCalledTimes(1);
  });
  it('steps through frames', async () => {
    const { press, view } = await keys();
    const run = vi.fn();
    view.keys = [{ key: ']', text: 'newer', run }];
    press(']', BODY);
    press(']', BODY, true);
    expect(run).toHaveBeenCalledTimes(2);
  });
});

describe('a held Enter', () => {
  const QUEUE = new FakeElement('BUTTON', ['[data-sends]']);
  beforeEach(() => {
    vi.resetModules();
  });
  it('does not press a button that sends, because the button received the focus from the same press', async () => {
    const { press } = await keys();
    expect(press('Enter', QUEUE, true)).toBe(true);
    expect(press('Enter', QUEUE)).toBe(false);
  });
  it('does not submit a form again, but repeats in a text', async () => {
    const { press } = await keys();
    expect(press('Enter', new FakeElement('INPUT', ['input']), true)).toBe(true);
    expect(press('Enter', new FakeElement('TEXTAREA'), true)).toBe(false);
  });
});

describe('g without a letter', () => {
  it('does not take a letter that is pressed later', async () => {
    vi.resetModules();
    vi.useFakeTimers();
    const { press, paths } = await keys();
    press('g', new FakeElement('BODY'));
    vi.advanceTimersByTime(3000);
    press('l', new FakeElement('BODY'));
    vi.useRealTimers();
    expect(paths).toEqual([]);
  });
});
