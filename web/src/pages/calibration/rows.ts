/**
 * Parse numbers pasted from a table: one row per line, separated by commas, semicolons, tabs or spaces. Lines that do
 * not start with a number are headings and are ignored.
 */
export function parseRows(text: string, columns: number): number[][] {
  const out: number[][] = [];
  text.split(/\r?\n/).forEach((line, k) => {
    const cells = line
      .replaceAll('\u2212', '-')
      .trim()
      .split(/[\s,;]+/)
      .filter(Boolean);
    if (!cells.length || !/^[-+.\d]/.test(cells[0] ?? '')) return;
    const row = cells.map(Number);
    if (row.length !== columns || row.some((v) => !Number.isFinite(v)))
      throw new Error(`line ${k + 1} is not ${columns} numbers: ${line.trim().slice(0, 40)}`);
    out.push(row);
  });
  return out;
}
