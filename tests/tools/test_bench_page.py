"""Individual sections of the benchmark page can be measured again."""

from __future__ import annotations

from tools.bench_page import updated
from tools.bench_tables import BenchTable


def table(title: str, figure: int) -> BenchTable:
    """Return a benchmark table with one figure."""
    return BenchTable("section", title, "Conditions.", 1, [("row", {"figure": figure})])


def test_only_the_measured_table_changes() -> None:
    """A measured table replaces the one with its title, or is added. Text and other tables do not change."""
    page = "# Page\n\nWords.\n\n" + table("One", 1).markdown() + "\n" + table("Two", 2).markdown()
    measured_again = updated(page, [table("One", 7)])
    assert measured_again == page.replace("| row | 1 |", "| row | 7 |")
    assert updated(measured_again, [table("One", 1)]) == page
    added = updated(page, [table("Three", 3)])
    assert added.startswith(page)
    assert "## Three" in added
