/** Parser for the options of a rehearsal: texts with a line for each answer and for each loss of signal. */
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
