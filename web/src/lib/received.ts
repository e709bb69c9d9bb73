/** Read the body of a response and count its bytes while it is received. */
import { bytes } from './format';

/** `total`: size of the body in bytes, null if the server does not state it. */
export interface Received {
  bytes: number;
  total: number | null;
}
/** Minimum time between two reports, and from the start to the first report. A fast response has no report. */
const FIRST_REPORT_MS = 300;
const REPORT_MS = 100;

/** Return the size of the body. The length of a compressed response is not the size of its content. */
function totalOf(headers: Headers): number | null {
  const length = Number(headers.get('Content-Length'));
  return length > 0 && !headers.has('Content-Encoding') ? length : null;
}

export async function readBody(response: Response, report: (received: Received) => void): Promise<ArrayBuffer> {
  const total = totalOf(response.headers);
  const parts: Uint8Array[] = [];
  const reader = response.body?.getReader();
  let [count, next] = [0, performance.now() + FIRST_REPORT_MS];
  for (let part = await reader?.read(); part && !part.done; part = await reader?.read()) {
    parts.push(part.value);
    count += part.value.byteLength;
    if (performance.now() < next) continue;
    report({ bytes: count, total });
    next = performance.now() + REPORT_MS;
  }
  const whole = new Uint8Array(count);
  let at = 0;
  for (const part of parts) {
    whole.set(part, at);
    at += part.byteLength;
  }
  return whole.buffer;
}

/** Return the progress as text: "1.2 MiB of 4.0 MiB", or "1.2 MiB received" if the total is unknown. */
export function receivedWords(received: Received): string {
  const { bytes: count, total } = received;
  return total === null ? `${bytes(count)} received` : `${bytes(count)} of ${bytes(total)}`;
}
