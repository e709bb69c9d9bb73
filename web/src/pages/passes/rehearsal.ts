/** Options of a rehearsal as a person types them: a line for each answer and for each loss of signal. */
export interface Outage {
  pass_number: number;
  after_s: number;
  for_s: number;
}

export interface TypedOptions {
  options: { answers: Record<string, string>; outages: Outage[] };
  /** The first line that cannot be read, in words; empty if all can. */
  problem: string;
}

const filled = (text: string): string[] =>
  text
    .split('\n')
    .map((line) => line.trim())
    .filter(Boolean);

export function rehearsalOptions(answers: string, losses: string): TypedOptions {
  const options: TypedOptions['options'] = { answers: {}, outages: [] };
  let problem = '';
  for (const line of filled(answers)) {
    const [step = '', answer = ''] = line.split(/:(.*)/).map((part) => part.trim());
    if (step && answer) options.answers[step] = answer;
    else problem ||= `“${line}” is not an answer. Write the step, a colon and the answer.`;
  }
  for (const line of filled(losses)) {
    const [number = NaN, after = NaN, long = NaN, ...more] = line.split(',').map((part) => Number(part.trim() || NaN));
    if (Number.isInteger(number) && number >= 1 && after >= 0 && long > 0 && !more.length)
      options.outages.push({ pass_number: number, after_s: after, for_s: long });
    else problem ||= `“${line}” is not a loss of signal. Write pass, seconds after rise, seconds long.`;
  }
  return { options, problem };
}
