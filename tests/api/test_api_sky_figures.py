"""Constellation lines over HTTP."""

from __future__ import annotations

import pytest
from fastapi.testclient import TestClient


def test_constellations_are_rows_of_positions_in_degrees(clients: dict[str, TestClient]) -> None:
    """A viewer can read the constellations. Crux has two lines, and the upright one joins Acrux and Gacrux."""
    lines_of = {figure["name"]: figure["lines"] for figure in clients["viewer"].get("/api/sky/figures").json()}
    assert len(lines_of) >= 40
    upright, _ = lines_of["Crux"]
    assert upright == [pytest.approx([186.65, -63.10], abs=0.02), pytest.approx([187.79, -57.11], abs=0.02)]
