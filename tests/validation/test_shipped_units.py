"""The shipped units: success rates as stated in their documents, and no wrong attitude."""

from __future__ import annotations

from gss.catalogue_tools.sources.hipparcos import load_stars, propagate
from validation.shipped.units import UNITS, shipped_units


def test_shipped_units_solve_and_are_never_wrong() -> None:
    """Oersted solves at least 80 % of the frames lost in space and tracks at rest. No attitude is wrong."""
    oersted = tuple(u for u in UNITS if u.name == "oersted")
    experiment = shipped_units(propagate(load_stars(8.0), 2026.0), 50, 3, lambda _: None, oersted)
    columns = {name: k for k, name in enumerate(experiment.columns)}
    assert len(experiment.rows) == 5
    assert [row[columns["wrong"]] for row in experiment.rows] == [0] * 5
    solved, at_rest = experiment.rows[0], experiment.rows[1]
    assert float(str(solved[columns["frames with an attitude (95 %)"]]).split()[0]) >= 80
    assert int(str(at_rest[columns["in tracking"]])) >= 4
