"""The observer's velocity and star epoch of a frame."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from astropy.coordinates import get_body_barycentric_posvel
from astropy.time import Time

from gss.domain.angles import ARCSEC_RAD
from gss.domain.errors import BadInput
from gss.operations.frames.frame_files import WITHOUT_ABERRATION
from gss.operations.frames.observer import epoch_of_frame, observer_at, observer_of_frame

MOMENT = datetime(2008, 9, 20, 12, 25, 40, tzinfo=UTC)
TLE = """1 25544U 98067A   08264.51782528 -.00002182  00000-0 -11606-4 0  2927
2 25544  51.6416 247.4627 0006703 130.5360 325.0288 15.72125391563537"""


def frame(**values: Any) -> Any:
    """Return a stored frame with the columns that these tests need."""
    row = {"source": "device", "taken": MOMENT, "time_known": True, "truth": None, "parameters": {}}
    return cast(Any, SimpleNamespace(**(row | values)))


def test_velocity_without_an_orbit_is_that_of_the_earth() -> None:
    """Without an orbit, the velocity is that of the Earth by astropy, within 0.05″ of aberration."""
    observer = observer_at(MOMENT)
    _, velocity = get_body_barycentric_posvel("earth", Time(MOMENT), ephemeris="builtin")
    difference = np.array(observer.velocity_c) - velocity.xyz.to_value("m/s") / 299_792_458.0
    assert np.linalg.norm(difference) < 0.05 * ARCSEC_RAD
    assert "was corrected" in observer.note


def test_an_orbit_adds_its_own_velocity() -> None:
    """A TLE adds the orbital velocity of 7.7 km/s in the orbit's plane."""
    added = np.array(observer_at(MOMENT, TLE).velocity_c) - np.array(observer_at(MOMENT).velocity_c)
    speed_km_s = np.linalg.norm(added) * 299_792.458
    assert 7.5 < speed_km_s < 7.8
    inclination, node = np.radians([51.64, 247.46])
    normal = np.array([np.sin(node) * np.sin(inclination), -np.cos(node) * np.sin(inclination), np.cos(inclination)])
    assert abs(added @ normal) / np.linalg.norm(added) < 0.01


def test_a_velocity_needs_a_known_time() -> None:
    """Frames with a known time have an observer. An import without a time has none, and a simulated frame only on
    request."""
    assert observer_of_frame(frame()) is not None
    assert observer_of_frame(frame(source="import")) is not None
    assert observer_of_frame(frame(source="import", time_known=False)) is None
    assert observer_of_frame(frame(truth=[0, 0, 0, 1])) is None
    assert observer_of_frame(frame(truth=[0, 0, 0, 1]), True) is not None
    assert observer_of_frame(frame(), False) is None


def test_an_imported_rendered_image_is_not_corrected() -> None:
    """An imported file with GSSABERR = F has no observer by default. A request overrides this."""
    rendered = frame(source="import", parameters={"file": {"format": "FITS", WITHOUT_ABERRATION: "yes"}})
    assert observer_of_frame(rendered) is None
    assert observer_of_frame(rendered, True) is not None
    assert epoch_of_frame(rendered) is not None
    assert observer_of_frame(frame(source="import", parameters={"file": {"format": "FITS"}})) is not None


def test_star_positions_are_those_of_the_exposure() -> None:
    """The epoch is the frame's Julian year rounded to a quarter, and None for an unknown time or a simulated sky."""
    assert epoch_of_frame(frame()) == 2008.75
    assert epoch_of_frame(frame(source="import", taken=MOMENT - timedelta(days=120))) == 2008.5
    assert epoch_of_frame(frame(source="import", time_known=False)) is None
    assert epoch_of_frame(frame(truth=[0, 0, 0, 1])) is None


def test_a_time_without_zone_is_rejected() -> None:
    """A time without a time zone is rejected."""
    with pytest.raises(BadInput, match="time zone"):
        observer_at(MOMENT.replace(tzinfo=None))
