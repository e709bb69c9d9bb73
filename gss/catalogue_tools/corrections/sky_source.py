"""Apply corrections to the stars of a source and record them. Each correction can be switched on or off.

The order follows the physical cause: magnitudes of the date, motion to the epoch, the camera's magnitudes, effective
centres of light, the observer's position and velocity, the axes. The default applies only ``propagate``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from typing import TypedDict

import numpy as np

from gss.catalogue_tools.corrections import doubles as pairs
from gss.catalogue_tools.corrections import variables
from gss.catalogue_tools.corrections.correction_switches import (
    Corrections,
    MeanOrbitVelocity,
    OrbitVelocity,
    frame_name,
)
from gss.catalogue_tools.corrections.corrections import aberrate, crossing_velocity_km_s, date_from_icrs, parallactic
from gss.catalogue_tools.corrections.ephemeris import LIGHT_KM_S, earth_motion, mean_earth_velocity_c
from gss.catalogue_tools.corrections.fk4 import to_b1950
from gss.catalogue_tools.corrections.instrument_magnitude import instrument_minus_v, roll_off_mag
from gss.catalogue_tools.sources.hipparcos import EPOCH_RANGE_JYEAR, propagate
from gss.domain.angles import Array, separation_rad
from gss.domain.camera_profile import CameraProfile
from gss.domain.errors import BadInput
from gss.domain.response import response_of
from gss.domain.stars import FLAG_VARIABLE, StarTable

CorrectionFact = Mapping[str, object]
"""One applied correction: ``name``, ``stars``, usually ``largest`` with its ``unit``, and values specific to the
correction."""


class SkyFacts(TypedDict):
    """The corrections as the manifest records them."""

    frame: str
    epoch_jyear: float
    date_jyear: float
    stars_in: int
    stars_out: int
    applied: list[CorrectionFact]


@dataclass(frozen=True)
class CorrectedSky:
    """Corrected stars with a record of the corrections.

    ``stars``: in the chosen frame. ``icrs_stars``: the same rows in ICRS axes, used to test membership of the envelope.
    ``rejected``: stars removed by the policy for doubles, ICRS. ``frame``: name of the frame for the manifest.
    ``facts``: record of the corrections as plain values.
    """

    stars: StarTable
    icrs_stars: StarTable
    rejected: StarTable
    frame: str
    facts: SkyFacts
    corrections: Corrections
    date_jyear: float

    def in_frame(self, stars: StarTable) -> StarTable:
        """Convert any rows of ``icrs_stars`` to the chosen frame."""
        return _in_frame(stars, self.corrections, self.date_jyear)


def corrected(
    stars: StarTable,
    corrections: Corrections,
    epoch_jyear: float,
    *,
    date_jyear: float | None = None,
    profile: CameraProfile | None = None,
) -> CorrectedSky:
    """Return the sky of ``epoch_jyear`` as seen on ``date_jyear`` (None: at the epoch). Both are Julian years of TT;
    UTC is accurate enough.

    Doubles are merged from all input stars. Apply the magnitude limit afterwards if faint companions matter. Raises
    BadInput if a date is out of range or a correction needs a camera profile.
    """
    date = epoch_jyear if date_jyear is None else date_jyear
    low, high = EPOCH_RANGE_JYEAR
    if not (low <= date <= high and low <= epoch_jyear <= high):
        raise BadInput(
            "date is out of range", expected=f"Julian year {low:g} to {high:g}", got=f"{date:g}, epoch {epoch_jyear:g}"
        )
    if corrections.needs_profile and profile is None:
        raise BadInput("a correction needs the camera", expected="a camera profile", got="none")
    facts: list[CorrectionFact] = []
    now = _magnitudes_of_date(stars, corrections, date, facts)
    if corrections.proper_motion:
        moved = propagate(now, epoch_jyear)
        facts.append(_shift_fact("proper_motion", now, moved, from_jyear=now.epoch_jyear, to_jyear=float(epoch_jyear)))
        now = moved
    if profile is not None:
        now = _camera_magnitudes(now, corrections, profile, facts)
    now, rejected = _merged(now, corrections, profile, facts)
    now = _seen_from_earth(now, corrections, date, facts)
    framed = _in_frame(now, corrections, date)
    name = frame_name(corrections, date)
    if corrections.frame != "icrs":
        facts.append({"name": "frame", "frame": name, "stars": len(framed)})
    summary: SkyFacts = {
        "frame": name,
        "epoch_jyear": now.epoch_jyear,
        "date_jyear": float(date),
        "stars_in": len(stars),
        "stars_out": len(now),
        "applied": facts,
    }
    return CorrectedSky(framed, now, rejected, name, summary, corrections, float(date))


def _shift_fact(name: str, before: StarTable, after: StarTable, **details: object) -> CorrectionFact:
    shift = separation_rad(before.icrs, after.icrs) if len(before) else np.zeros(1)
    moved = int(np.count_nonzero(shift > 0))
    return {"name": name, "stars": moved, "largest": float(shift.max()), "unit": "rad", **details}


def _light_fact(name: str, before: StarTable, after: StarTable, **details: object) -> CorrectionFact:
    change = np.abs(after.v_mag - before.v_mag) if len(before) else np.zeros(1)
    return {
        "name": name,
        "stars": int(np.count_nonzero(change > 0)),
        "largest": float(change.max()),
        "unit": "mag",
        **details,
    }


def _magnitudes_of_date(
    stars: StarTable, corrections: Corrections, date: float, facts: list[CorrectionFact]
) -> StarTable:
    now = stars
    if corrections.flag_variables:
        flagged = variables.flagged(now)
        new = int(np.count_nonzero(flagged.flags != now.flags))
        total = int(np.count_nonzero(flagged.flags & FLAG_VARIABLE))
        facts.append(
            {"name": "flag_variables", "stars": new, "variables": total, "source": "Hipparcos, Jacobs 1995 Table A-1"}
        )
        now = flagged
    if corrections.variables_at_date:
        dated = variables.at_date(now, date)
        facts.append(_light_fact("variables_at_date", now, dated, source="GCVS 5.1"))
        now = dated
    return now


def _camera_magnitudes(
    stars: StarTable, corrections: Corrections, profile: CameraProfile, facts: list[CorrectionFact]
) -> StarTable:
    now = stars
    if corrections.instrument_magnitude:
        response = response_of(profile)
        corrected = replace(now, v_mag=now.v_mag + instrument_minus_v(now.b_v, response, corrections.unknown_b_v))
        guessed = int(np.count_nonzero(np.isnan(now.b_v)))
        facts.append(
            _light_fact(
                "instrument_magnitude",
                now,
                corrected,
                response=response.name,
                source=response.source,
                no_colour=guessed,
            )
        )
        now = corrected
    if corrections.roll_off != "off":
        dimmed = replace(now, v_mag=now.v_mag + roll_off_mag(profile, corrections.roll_off))
        facts.append(
            _light_fact("roll_off", now, dimmed, over=corrections.roll_off, corner_loss=profile.defects.corner_loss)
        )
        now = dimmed
    return now


def _merged(
    stars: StarTable, corrections: Corrections, profile: CameraProfile | None, facts: list[CorrectionFact]
) -> tuple[StarTable, StarTable]:
    if corrections.doubles is None:
        return stars, stars.take(np.zeros(len(stars), bool))
    merged = pairs.merge(stars, corrections.doubles, profile)
    facts.append(
        {
            "name": "doubles",
            "policy": corrections.doubles.policy,
            "separation_rad": merged.separation_rad,
            "stars": merged.members,
            "centres": merged.groups,
            "rejected": len(merged.rejected),
            "largest": merged.largest_shift_rad,
            "unit": "rad",
        }
    )
    return merged.stars, merged.rejected


def _seen_from_earth(stars: StarTable, corrections: Corrections, date: float, facts: list[CorrectionFact]) -> StarTable:
    now = stars
    if corrections.parallax:
        near = replace(now, icrs=parallactic(now.icrs, now.parallax_rad, earth_motion(date)[0]))
        facts.append(_shift_fact("parallax", now, near, below_zero=int(np.count_nonzero(now.parallax_rad < 0))))
        now = near
    annual = mean_earth_velocity_c(date, corrections.aberration_days) if corrections.annual_aberration else np.zeros(3)
    if corrections.annual_aberration:
        # Velocities must be added before aberration is applied, so the second step uses the positions without
        # aberration.
        shifted = replace(now, icrs=aberrate(now.icrs, annual))
        velocity = [float(v) for v in annual * LIGHT_KM_S]
        facts.append(
            _shift_fact("annual_aberration", now, shifted, velocity_km_s=velocity, days=corrections.aberration_days)
        )
    if corrections.orbital_aberration is None:
        return shifted if corrections.annual_aberration else now
    orbital = _orbital_velocity_km_s(now.icrs, corrections.orbital_aberration) / LIGHT_KM_S
    both = replace(now, icrs=_aberrate_each(now.icrs, orbital + annual))
    facts.append(
        _shift_fact(
            "orbital_aberration",
            shifted if corrections.annual_aberration else now,
            both,
            **asdict(corrections.orbital_aberration),
        )
    )
    return both


def _orbital_velocity_km_s(unit: Array, orbit: OrbitVelocity | MeanOrbitVelocity) -> Array:
    if isinstance(orbit, OrbitVelocity):
        return np.broadcast_to(np.array(orbit.km_s, float), unit.shape)
    if orbit.boresight_orbit is None:
        return np.zeros_like(unit)
    return crossing_velocity_km_s(unit, orbit.speed_km_s, np.array(orbit.normal_icrs), np.array(orbit.boresight_orbit))


def _aberrate_each(unit: Array, velocity_c: Array) -> Array:
    """Apply aberration with a separate velocity for each direction."""
    inverse_gamma = np.sqrt(1 - np.sum(velocity_c**2, axis=1))[:, None]
    along = np.sum(unit * velocity_c, axis=1)[:, None]
    return np.asarray((inverse_gamma * unit + (1 + along / (1 + inverse_gamma)) * velocity_c) / (1 + along))


def _in_frame(stars: StarTable, corrections: Corrections, date: float) -> StarTable:
    if corrections.frame == "icrs":
        return stars
    if corrections.frame == "of_date":
        turn = date_from_icrs(date).T
        return replace(stars, icrs=stars.icrs @ turn, proper_motion_rad_yr=stars.proper_motion_rad_yr @ turn)
    place, motion = to_b1950(stars.icrs, stars.proper_motion_rad_yr, stars.epoch_jyear, corrections.e_terms)
    return replace(stars, icrs=place, proper_motion_rad_yr=motion)
