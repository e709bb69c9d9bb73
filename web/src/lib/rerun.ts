/** Loads the Rerun viewer that the installed SDK ships, from this origin, once per page. */

export interface ViewerHandle {
  start(canvas: HTMLCanvasElement): Promise<void>;
  add_receiver(url: string): void;
  destroy(): void;
  free(): void;
  has_panicked(): boolean;
  panic_message(): string | undefined;
}
interface Bindgen {
  (options: { module_or_path: Promise<Response> }): Promise<unknown>;
  WebHandle: new (options: Record<string, unknown>) => ViewerHandle;
}
/** The viewer's script declares this at its top level: a global binding, but not a property of window. */
declare const wasm_bindgen: Bindgen;

const BASE = '/api/rerun';
let ready: Promise<Bindgen> | null = null;

function script(): Promise<void> {
  return new Promise((resolve, reject) => {
    const tag = document.createElement('script');
    tag.src = `${BASE}/re_viewer.js`;
    tag.onload = () => resolve();
    tag.onerror = () => { tag.remove(); reject(new Error('The server has no Rerun viewer: its files come out of the installed Rerun SDK. Install the SDK and restart the server; the recording can still be saved and opened elsewhere.')); };
    document.head.append(tag);
  });
}

async function wasm(progress: (text: string) => void): Promise<Response> {
  const response = await fetch(`${BASE}/re_viewer_bg.wasm`);
  if (!response.ok || !response.body) throw new Error(`The viewer's program could not be read (${response.status}).`);
  let bytes = 0;
  const counted = response.body.pipeThrough(new TransformStream<Uint8Array, Uint8Array>({
    transform(chunk, out) {
      bytes += chunk.byteLength;
      progress(`Loading the viewer, ${(bytes / 1e6).toFixed(0)} MB`);
      out.enqueue(chunk);
    },
    flush: () => progress('Starting the viewer …'),
  }));
  return new Response(counted, { headers: { 'Content-Type': 'application/wasm' } });
}

async function load(progress: (text: string) => void): Promise<Bindgen> {
  await script();
  await wasm_bindgen({ module_or_path: wasm(progress) });
  return wasm_bindgen;
}

export async function openViewer(canvas: HTMLCanvasElement, url: string, progress: (text: string) => void, event: (data: string) => void): Promise<ViewerHandle> {
  ready ??= load(progress).catch((e: unknown) => { ready = null; throw e; });
  const bindgen = await ready;
  const handle = new bindgen.WebHandle({
    url: [url], render_backend: 'webgl', hide_welcome_screen: true, persist: false, theme: 'dark', notebook: false, video_decoder: null,
    panel_state_overrides: { top: 'Hidden', blueprint: 'Hidden', selection: 'Hidden', time: 'Collapsed' }, on_viewer_event: event,
  });
  await handle.start(canvas);
  return handle;
}
