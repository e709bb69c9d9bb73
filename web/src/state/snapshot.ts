/**
 * Log of the items that the stream reports while a snapshot is loading. They are newer than the snapshot and have
 * priority.
 */
export class UpdateLog {
  private readonly open = new Set<Set<string>>();

  /** Record stream messages from now until `end`. */
  begin(): Set<string> {
    const updates = new Set<string>();
    this.open.add(updates);
    return updates;
  }

  end(updates: Set<string>): void {
    this.open.delete(updates);
  }

  /** Record that the stream reported this kind of item, with its id if it has one. */
  note(kind: string, data: unknown): void {
    const row = data as { id?: number; iteration?: number } | null;
    for (const updates of this.open) updates.add(kind).add(`${kind} ${row?.id ?? row?.iteration}`);
  }
}

/**
 * Return the rows of a snapshot, newest first. Items that the stream reported during the load are replaced by their
 * present state, or removed if they were closed. `held`: the present rows.
 */
export function merged<R extends { id: number }>(
  kind: string,
  read: readonly R[],
  held: readonly R[],
  updates: ReadonlySet<string>,
): R[] {
  return mergedBy((r) => r.id, kind, read, held, updates).sort((a, b) => b.id - a.id);
}

export function mergedBy<R>(
  key: (row: R) => number,
  kind: string,
  read: readonly R[],
  held: readonly R[],
  updates: ReadonlySet<string>,
): R[] {
  const fresh = (r: R): boolean => updates.has(`${kind} ${key(r)}`);
  return [...held.filter(fresh), ...read.filter((r) => !fresh(r))];
}
