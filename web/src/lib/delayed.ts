/** Return a function that runs `run` after `ms` milliseconds. Calls in the meantime start this time again. */
export function delayed(run: () => void, ms: number): () => void {
  let timer: ReturnType<typeof setTimeout> | undefined;
  return () => {
    clearTimeout(timer);
    timer = setTimeout(run, ms);
  };
}
