/** A snapshot that was asked for is older than what the stream told while it was on its way: the stream's word stands. */
export class Told {
  private readonly open = new Set<Set<string>>();

  /** What comes from now on is remembered, until `end`. */
  begin(): Set<string> {
    const told = new Set<string>();
    this.open.add(told);
    return told;
  }

  end(told: Set<string>): void {
    this.open.delete(told);
  }

  /** The stream told this kind of thing, of this id where it has one. */
  note(kind: string, data: unknown): void {
    const row = data as { id?: number; iteration?: number } | null;
    for (const told of this.open) told.add(kind).add(`${kind} ${row?.id ?? row?.iteration}`);
  }
}

/** The rows of a snapshot, newest first, with those that the stream told meanwhile as they are held (or gone, where it closed them). */
export function merged<R extends { id: number }>(kind: string, read: readonly R[], held: readonly R[], told: ReadonlySet<string>): R[] {
  return mergedBy((r) => r.id, kind, read, held, told).sort((a, b) => b.id - a.id);
}

export function mergedBy<R>(key: (row: R) => number, kind: string, read: readonly R[], held: readonly R[], told: ReadonlySet<string>): R[] {
  const fresh = (r: R): boolean => told.has(`${kind} ${key(r)}`);
  return [...held.filter(fresh), ...read.filter((r) => !fresh(r))];
}
