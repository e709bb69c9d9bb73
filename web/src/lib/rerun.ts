/**
 * Load the Rerun viewer once per page, from the SDK installed on the server, and open stored and live recordings in it.
 */
import { base } from './base';
import { Pieces, readEvent, setTimeCursor, type ViewerEvent } from './rerun_control';

interface Handle {
  start(canvas: HTMLCanvasElement): Promise<void>;
  open_channel(id: string, name: string): void;
  send_rrd_to_channel(id: string, data: Uint8Array): void;
  close_channel(id: string): void;
  viewer_control(request: Uint8Array): Promise<Uint8Array>;
  destroy(): void;
  free(): void;
}
interface Bindgen {
  (options: { module_or_path: Promise<Response> }): Promise<unknown>;
  WebHandle: new (options: Record<string, unknown>) => Handle;
}
/** Declared at top level of the viewer's script: a global binding, but not a property of window. */
declare const wasm_bindgen: Bindgen;

const VIEWER = `${base}/api/rerun`;
let ready: Promise<Bindgen> | null = null;

function script(): Promise<void> {
  return new Promise((resolve, reject) => {
    const tag = document.createElement('script');
    tag.src = `${VIEWER}/re_viewer.js`;
    tag.onload = () => resolve();
    tag.onerror = () => {
      tag.remove();
      reject(
        new Error(
          'The server has no Rerun viewer, which is part of the Rerun SDK. Install the SDK and restart the server. ' +
            'You can also save the recording and open it on another computer.',
        ),
      );
    };
    document.head.append(tag);
  });
}

/** Pass a response body through and report the number of bytes received. */
function counted(response: Response, progress: (bytes: number) => void, done?: () => void): ReadableStream<Uint8Array> {
  if (!response.body) throw new Error('the response is empty');
  let bytes = 0;
  return response.body.pipeThrough(
    new TransformStream<Uint8Array, Uint8Array>({
      transform(chunk, out) {
        bytes += chunk.byteLength;
        progress(bytes);
        out.enqueue(chunk);
      },
      flush: () => done?.(),
    }),
  );
}

async function wasm(progress: (text: string) => void): Promise<Response> {
  const response = await fetch(`${VIEWER}/re_viewer_bg.wasm`);
  if (!response.ok) throw new Error(`The viewer could not be loaded (status ${response.status}).`);
  const body = counted(
    response,
    (n) => progress(`Loading the viewer, ${(n / 1e6).toFixed(0)} MB`),
    () => progress('Starting the viewer …'),
  );
  return new Response(body, { headers: { 'Content-Type': 'application/wasm' } });
}

async function load(progress: (text: string) => void): Promise<Bindgen> {
  await script();
  await wasm_bindgen({ module_or_path: wasm(progress) });
  return wasm_bindgen;
}

async function fetched(url: string, signal: AbortSignal): Promise<Response> {
  const response = await fetch(url, { signal });
  if (response.ok) return response;
  const problem = (await response.json().catch(() => ({}))) as { message?: string; hint?: string };
  throw new Error(
    `No recording: ${problem.message ?? `The server answered with status ${response.status}.`}` +
      (problem.hint ? ` ${problem.hint}` : ''),
  );
}

/** A viewer on a canvas. The page fetches the data with its session; the viewer sends no requests to the server. */
export class Viewer {
  private channels = 0;
  private download: AbortController | null = null;
  private constructor(private readonly handle: Handle) {}

  static async on(
    canvas: HTMLCanvasElement,
    progress: (text: string) => void,
    onEvent: (event: ViewerEvent) => void,
  ): Promise<Viewer> {
    ready ??= load(progress).catch((e: unknown) => {
      ready = null;
      throw e;
    });
    const bindgen = await ready;
    const handle = new bindgen.WebHandle({
      url: [],
      render_backend: 'webgl',
      hide_welcome_screen: true,
      persist: false,
      theme: 'dark',
      notebook: false,
      video_decoder: null,
      panel_state_overrides: { top: 'Hidden', blueprint: 'Hidden', selection: 'Hidden', time: 'Collapsed' },
      on_viewer_event: (data: string) => {
        const event = readEvent(data);
        if (event) onEvent(event);
      },
    });
    await handle.start(canvas);
    return new Viewer(handle);
  }

  /** Open a complete recording. Returns its size in bytes, and n if it contains only every n-th frame. */
  async open(url: string, progress: (text: string) => void): Promise<{ bytes: number; every: number }> {
    this.download?.abort();
    this.download = new AbortController();
    progress('Writing the recording …');
    const response = await fetched(url, this.download.signal);
    const data = new Uint8Array(
      await new Response(
        counted(response, (n) => progress(`Loading the recording, ${(n / 1e6).toFixed(1)} MB`)),
      ).arrayBuffer(),
    );
    this.channel(url, data);
    return { bytes: data.length, every: Number(response.headers.get('X-GSS-Every')) || 1 };
  }

  /** Follow a growing recording until the viewer is closed. `grew` is called for each piece. */
  async follow(url: string, grew: (pieces: number, bytes: number) => void): Promise<void> {
    this.download?.abort();
    const download = (this.download = new AbortController());
    const response = await fetched(url, download.signal);
    const id = this.channel('live');
    const pieces = new Pieces();
    let [count, bytes] = [0, 0];
    const reader = response.body?.getReader();
    for (let part = await reader?.read(); part && !part.done; part = await reader?.read()) {
      for (const piece of pieces.push(part.value)) {
        this.handle.send_rrd_to_channel(id, piece);
        grew(++count, (bytes += piece.length));
      }
    }
    throw new Error('The live recording ended: the server stopped, or your session ended.');
  }

  private channel(name: string, data?: Uint8Array): string {
    const id = `gss-${++this.channels}`;
    this.handle.open_channel(id, name);
    if (data) {
      this.handle.send_rrd_to_channel(id, data);
      this.handle.close_channel(id);
    }
    return id;
  }

  /** Show a frame of the open recording. Returns false if no recording is open. */
  async showFrame(id: number): Promise<boolean> {
    return this.handle.viewer_control(setTimeCursor('frame', BigInt(id))).then(
      () => true,
      () => false,
    );
  }

  /** Move the cursor of the timeline `utc` to a time, in milliseconds. */
  showTime(atMs: number): void {
    this.handle.viewer_control(setTimeCursor('utc', BigInt(Math.round(atMs)) * 1_000_000n)).catch(() => undefined);
  }

  close(): void {
    this.download?.abort();
    this.handle.destroy();
    this.handle.free();
  }
}
