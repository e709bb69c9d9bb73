"""The constellations' lines over HTTP."""

from __future__ import annotations

import pytest
from fastapi.testclient import TestClient


def test_figures_are_rows_of_places_in_degrees(clients: dict[str, TestClient]) -> None:
    """Of everybody who may look; Crux is two strokes, and the upright one goes from Acrux to Gacrux."""
    found = {figure["name"]: figure["lines"] for figure in clients["viewer"].get("/api/sky/figures").json()}
    assert len(found) >= 40
    upright, _ = found["Crux"]
    assert upright == [pytest.approx([186.65, -63.10], abs=0.02), pytest.approx([187.79, -57.11], abs=0.02)]
