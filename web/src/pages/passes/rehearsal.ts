/** Options of a rehearsal, parsed from text, and the record and the timeline of its report. */
import type { RehearsalReport } from '../../api/types';

export interface Outage {
  pass_number: number;
  after_s: number;
  for_s: number;
}

export interface TypedOptions {
  options: { answers: Record<string, string>; outages: Outage[] };
  /** Message about the first invalid line; empty if all lines are valid. */
  problem: string;
}

const nonEmptyLines = (text: string): string[] =>
  text
    .split('\n')
    .map((line) => line.trim())
    .filter(Boolean);

export function rehearsalOptions(answers: string, losses: string): TypedOptions {
  const options: TypedOptions['options'] = { answers: {}, outages: [] };
  let problem = '';
  for (const line of nonEmptyLines(answers)) {
    const [step = '', answer = ''] = line.split(/:(.*)/).map((part) => part.trim());
    if (step && answer) options.answers[step] = answer;
    else problem ||= `“${line}” is not an answer. Enter the step, a colon and the answer.`;
  }
  for (const line of nonEmptyLines(losses)) {
    const [number = NaN, after = NaN, long = NaN, ...more] = line.split(',').map((part) => Number(part.trim() || NaN));
    if (Number.isInteger(number) && number >= 1 && after >= 0 && long > 0 && !more.length)
      options.outages.push({ pass_number: number, after_s: after, for_s: long });
    else problem ||= `“${line}” is not a loss of signal. Enter pass, seconds after rise, duration in seconds.`;
  }
  return { options, problem };
}

export interface RecordLine {
  at: string;
  text: string;
}

/** Return the state changes and the steps that a person ran, in order of time. */
export function recordLines(report: RehearsalReport): RecordLine[] {
  return [
    ...report.transitions.map((t) => ({ at: t.at, text: t.reason ? `${t.state}: ${t.reason}` : t.state })),
    ...report.person.map((p) => ({ at: p.at, text: `${p.kind} ${p.step}, answered by the ${p.user}: ${p.answer}` })),
  ].sort((a, b) => Date.parse(a.at) - Date.parse(b.at));
}

export interface Span {
  /** Seconds after the rise of the pass. */
  from: number;
  to: number;
}

export interface ItemSpan extends Span {
  /** Index of the plan item. */
  item: number;
}

export interface PassLane {
  rise: string;
  window_s: number;
  /** Times at which the plan was running. */
  running: Span[];
  items: ItemSpan[];
}

const overlap = (a: Span, b: Span): Span => ({ from: Math.max(a.from, b.from), to: Math.min(a.to, b.to) });

/** Return for each pass when the plan was running, and which item it executed. Items are executed one after another. */
export function passLanes(report: RehearsalReport): PassLane[] {
  const unix = (iso: string): number => Date.parse(iso) / 1000;
  const ends = [...report.transitions.slice(1).map((t) => unix(t.at)), Infinity];
  const running = report.transitions.flatMap((t, i): Span[] =>
    t.state === 'running' ? [{ from: unix(t.at), to: ends[i] ?? Infinity }] : [],
  );
  const started = report.items.map((item) => (item.started ? unix(item.started) : Infinity));
  const items = started.map((from, i): Span => ({ from, to: Math.min(...started.slice(i + 1), Infinity) }));
  return report.passes.map((pass) => {
    const window: Span = { from: unix(pass.rise), to: unix(pass.set) };
    const after = (span: Span): Span => ({ from: span.from - window.from, to: span.to - window.from });
    const inPass = running.map((span) => overlap(span, window)).filter((span) => span.to > span.from);
    return {
      rise: pass.rise,
      window_s: window.to - window.from,
      running: inPass.map(after),
      items: items.flatMap((item, i) =>
        inPass
          .map((span) => overlap(span, item))
          .filter((span) => span.to > span.from)
          .map((span) => ({ ...after(span), item: i })),
      ),
    };
  });
}
