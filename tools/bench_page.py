"""Replace tables on the benchmark page with new results under the same titles."""

from __future__ import annotations

from collections.abc import Sequence

from tools.bench_tables import BenchTable


def updated(page: str, tables: Sequence[BenchTable]) -> str:
    """Return the page with the section of each table replaced, from its title to the next heading. New tables are
    appended."""
    for table in tables:
        head, new = f"## {table.title}\n", table.markdown().rstrip("\n") + "\n"
        start = 0 if page.startswith(head) else page.find("\n" + head) + 1
        if start == 0 and not page.startswith(head):
            page = page.rstrip("\n") + "\n\n" + new
            continue
        lines = page[start + len(head) :].splitlines(keepends=True)
        length = next((k for k, line in enumerate(lines) if line.startswith(("#", "**"))), len(lines))
        remainder = "".join(lines[length:])
        page = page[:start] + new + ("\n" + remainder if remainder else "")
    return page
