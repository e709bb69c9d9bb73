"""Names of planets in a solved frame. Their true positions are those of astropy."""

from __future__ import annotations

import warnings
from datetime import UTC, datetime, timedelta
from typing import Any

import numpy as np
import pytest
from astropy.coordinates import GCRS, get_body
from astropy.time import Time
from astropy.utils import iers

from gss.domain.angles import ra_dec_from_unit
from gss.domain.frames import cam_from_icrs
from gss.instruments.registry import shipped_camera
from gss.operations.frames.planets import with_planets

AT = datetime(2026, 6, 9, 20, tzinfo=UTC)
"""Venus and Jupiter are 1.7° apart."""
CAMERA = shipped_camera("cubestar").camera


def star(index: int, position: np.ndarray, flux_dn: float, **matched: Any) -> dict[str, Any]:
    """Return a measured star as in a stored solution."""
    col_px, row_px = map(float, position)
    return {"index": index, "col_px": col_px, "row_px": row_px, "flux_dn": flux_dn, **matched}


@pytest.fixture(scope="module")
def scene() -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Attitude of a camera that points between Venus and Jupiter, and their pixels."""
    with iers.conf.set_temp("auto_download", False), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        time = Time(AT)
        places = {name: get_body(name, time).transform_to(GCRS(obstime=time)) for name in ("venus", "jupiter")}
    units = {
        name: place.cartesian.xyz.value / np.linalg.norm(place.cartesian.xyz.value) for name, place in places.items()
    }
    between = sum(units.values())
    ra, dec = ra_dec_from_unit((between / np.linalg.norm(between))[None])
    attitude = cam_from_icrs(float(ra[0]), float(dec[0]), 0.3)
    return attitude, {name: CAMERA.project((attitude @ unit)[None])[0] for name, unit in units.items()}


def test_unmatched_stars_at_the_positions_of_planets_are_named(scene) -> None:
    """Both planets are named with their magnitudes. GCRS directions contain aberration, like those of a camera whose attitude
    was not corrected for it: the aberration of both planets is nearly equal, so it shifts the attitude only."""
    attitude, pixels = scene
    stars = [star(0, pixels["venus"], 9e4), star(1, pixels["jupiter"], 4e4), star(2, pixels["venus"] + 60, 1e3)]
    named = with_planets(stars, CAMERA, attitude, None, AT)
    assert [row.get("name") for row in named] == ["Venus", "Jupiter", None]
    assert named[0]["v_mag"] == pytest.approx(-3.9, abs=0.3)
    assert named[1]["v_mag"] == pytest.approx(-1.9, abs=0.3)
    assert "name" not in stars[0]


def test_matched_stars_and_other_days_are_not_named(scene) -> None:
    """A star of the catalogue keeps its name, the brightest of two unmatched stars is named, and a month later Venus is
    elsewhere."""
    attitude, pixels = scene
    at = pixels["venus"]
    stars = [star(0, at, 9e5, name="Pollux", hip=37826), star(1, at + 0.5, 10.0), star(2, at - 0.5, 80.0)]
    named = with_planets(stars, CAMERA, attitude, None, AT)
    assert [row.get("name") for row in named] == ["Pollux", None, "Venus"]
    later = with_planets(stars[1:], CAMERA, attitude, None, AT + timedelta(days=30))
    assert [row.get("name") for row in later] == [None, None]
