"""Epoch of the star positions and velocity of the observer for a stored frame. Both need the time of observation."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import UTC, datetime
from typing import TYPE_CHECKING

import numpy as np
from sgp4.api import jday

from gss.catalogue_tools.corrections.ephemeris import LIGHT_KM_S, earth_motion, teme_from_icrs
from gss.catalogue_tools.envelope.orbits import jyear_of, read_tle
from gss.domain.angles import ARCSEC_RAD, Array
from gss.domain.errors import BadInput
from gss.operations.frames.frame_files import WITHOUT_ABERRATION

if TYPE_CHECKING:
    from gss.store.models import Frame

EPOCH_STEP_YR = 0.25
"""Step between epochs. Frames of the same step share their star and pair tables. The fastest star moves by 1.3″ in half
a step."""


@dataclass(frozen=True)
class Observer:
    """Motion of the observer. ``velocity_c``: (3,) velocity relative to the barycentre, ICRS, in units of c. ``note``: text for
    the notes of the result."""

    velocity_c: tuple[float, float, float]
    note: str


def observer_at(moment: datetime, tle: str | None = None) -> Observer:
    """Return the Earth's motion at a time with a time zone. ``tle``: two-line element set of a satellite, whose velocity is added.
    Raises BadInput."""
    if moment.tzinfo is None:
        raise BadInput("the time has no time zone", expected="a UTC time", got=str(moment))
    earth = earth_motion(jyear_of(moment))[1]
    orbit = np.zeros(3) if tle is None else orbit_velocity_c(moment, tle)
    x, y, z = (float(v) for v in earth + orbit)
    of = "the Earth" if tle is None else "the Earth and the orbit"
    largest = float(np.linalg.norm([x, y, z])) / ARCSEC_RAD
    return Observer((x, y, z), f"aberration by the motion of {of} (up to {largest:.1f}″) was corrected")


def orbit_velocity_c(moment: datetime, tle: str) -> Array:
    """Return the (3,) ICRS velocity of a satellite relative to the Earth in units of c, by SGP4. Raises BadInput."""
    utc = moment.astimezone(UTC)
    jd, part = jday(utc.year, utc.month, utc.day, utc.hour, utc.minute, utc.second + utc.microsecond * 1e-6)
    error, _, velocity_km_s = read_tle(tle).sgp4(jd, part)
    if error:
        raise BadInput(
            "the element set has no orbit at that time", expected="a time near its epoch", got=f"{utc:%Y-%m-%d}"
        )
    return np.asarray(teme_from_icrs(jyear_of(moment)).T @ np.asarray(velocity_km_s) / LIGHT_KM_S)


def observer_of_frame(frame: Frame, override: bool | None = None) -> Observer | None:
    """Return the observer of a stored frame for the correction of aberration, None for no correction.

    By default, frames are corrected if their time is known. Frames of the simulator are not corrected, because they contain
    aberration only if it is enabled there. Files of ``gss render`` state that they contain none. ``override``: True or False
    to override this choice.
    """
    by_default = _shows_the_sky_of_its_time(frame) and not drawn_without_aberration(frame)
    if not (by_default if override is None else override):
        return None
    return observer_at(frame.taken)


def drawn_without_aberration(frame: Frame) -> bool:
    """Return True for a frame of the simulator and for an imported file that states that its sky contains no aberration."""
    file = frame.parameters.get("file")
    return frame.truth is not None or (isinstance(file, dict) and WITHOUT_ABERRATION in file)


def epoch_of_frame(frame: Frame) -> float | None:
    """Return the Julian year of the star positions for a stored frame, None if its time is unknown or its sky is simulated."""
    return epoch_at(frame.taken) if _shows_the_sky_of_its_time(frame) else None


def epoch_at(moment: datetime) -> float:
    """Return the Julian year of the star positions for a time, rounded to steps of :data:`EPOCH_STEP_YR`."""
    return round(jyear_of(moment) / EPOCH_STEP_YR) * EPOCH_STEP_YR


def _shows_the_sky_of_its_time(frame: Frame) -> bool:
    return frame.time_known and frame.truth is None
