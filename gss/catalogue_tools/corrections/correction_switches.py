"""Parameters of the corrections applied to the stars of a source."""

from __future__ import annotations

from dataclasses import asdict, dataclass, fields
from typing import Any

import numpy as np

from gss.catalogue_tools.corrections.doubles import Doubles
from gss.catalogue_tools.corrections.instrument_magnitude import B_V_RANGE, ROLL_OFFS
from gss.domain.errors import BadInput
from gss.domain.json_object import JsonObject

FRAMES = ("icrs", "of_date", "b1950")
FASTEST_ORBIT_KM_S = 20.0
Triple = tuple[float, float, float]


@dataclass(frozen=True)
class OrbitVelocity:
    """Velocity of the satellite relative to the Earth at one time, ICRS."""

    km_s: Triple

    def __post_init__(self) -> None:
        _check_speed(float(np.linalg.norm(self.km_s)))


@dataclass(frozen=True)
class MeanOrbitVelocity:
    """Velocity at the time each star crosses the middle of a field fixed in the orbit frame (docs/conventions.md).

    ``normal_icrs``: pole of the circular orbit. ``boresight_orbit`` None: the field does not rotate with the orbit. In
    this case the mean velocity over a revolution is zero, and the facts state the uncorrected speed.
    """

    speed_km_s: float
    normal_icrs: Triple
    boresight_orbit: Triple | None = None

    def __post_init__(self) -> None:
        _check_speed(self.speed_km_s)
        for vector in (self.normal_icrs, self.boresight_orbit):
            if vector is not None and not np.linalg.norm(vector) > 0:
                raise BadInput("a direction is a zero vector", expected="three numbers, not all zero", got=str(vector))


@dataclass(frozen=True)
class Corrections:
    """Corrections to apply, with their parameters; the default is proper motion alone.

    ``annual_aberration``: velocity of the Earth about the Solar System's barycentre, averaged over ``aberration_days``
    around the date. ``frame``: "of_date" is the mean equator and equinox of the date; "b1950" is the FK4 frame, with or
    without ``e_terms``. ``instrument_magnitude``: replace V by the camera's magnitude, using ``unknown_b_v`` for stars
    without B−V; ``roll_off`` adds the light loss of the lens. ``doubles`` None: no stars are merged.
    """

    proper_motion: bool = True
    parallax: bool = False
    annual_aberration: bool = False
    aberration_days: float = 0.0
    orbital_aberration: OrbitVelocity | MeanOrbitVelocity | None = None
    frame: str = "icrs"
    e_terms: bool = True
    instrument_magnitude: bool = False
    roll_off: str = "off"
    unknown_b_v: float = 0.6
    doubles: Doubles | None = None
    flag_variables: bool = False
    variables_at_date: bool = False

    def __post_init__(self) -> None:
        if self.frame not in FRAMES:
            raise BadInput("unknown frame", expected=" | ".join(FRAMES), got=str(self.frame))
        if self.roll_off not in ROLL_OFFS:
            raise BadInput("unknown lens roll-off", expected=" | ".join(ROLL_OFFS), got=str(self.roll_off))
        if not 0 <= self.aberration_days <= 366:
            raise BadInput(
                "days of mean aberration are out of range", expected="0 to 366", got=f"{self.aberration_days}"
            )
        if not B_V_RANGE[0] <= self.unknown_b_v <= B_V_RANGE[1]:
            raise BadInput(
                "colour is out of range",
                expected=f"B−V {B_V_RANGE[0]:g} to {B_V_RANGE[1]:g}",
                got=f"{self.unknown_b_v:g}",
            )
        if self.frame == "b1950" and self.e_terms and self.annual_aberration:
            raise BadInput(
                "positions with E-terms already contain a part of annual aberration",
                expected="e_terms off with annual_aberration in b1950",
                got="both on",
                hint="switch off the E-terms or the aberration",
            )

    @property
    def applied(self) -> tuple[str, ...]:
        """Names of the active corrections."""
        switches = {
            "proper_motion": self.proper_motion,
            "parallax": self.parallax,
            "annual_aberration": self.annual_aberration,
            "orbital_aberration": self.orbital_aberration is not None,
            "frame": self.frame != "icrs",
            "instrument_magnitude": self.instrument_magnitude,
            "roll_off": self.roll_off != "off",
            "doubles": self.doubles is not None,
            "flag_variables": self.flag_variables,
            "variables_at_date": self.variables_at_date,
        }
        return tuple(name for name, on in switches.items() if on)

    @property
    def needs_profile(self) -> bool:
        """True if a camera profile is required."""
        return (
            self.instrument_magnitude
            or self.roll_off != "off"
            or (self.doubles is not None and self.doubles.separation_rad is None)
        )

    def as_dict(self) -> JsonObject:
        """Return plain values for a manifest. ``corrections_of`` is the inverse."""
        content = asdict(self)
        for name in ("orbital_aberration", "doubles"):
            if content[name] is not None:
                content[name] = {k: list(v) if isinstance(v, tuple) else v for k, v in content[name].items()}
        return content


def corrections_of(values: JsonObject) -> Corrections:
    """Return the corrections from the plain values of ``Corrections.as_dict``. Raises BadInput if the values are not
    valid."""
    content = dict(values)
    orbit, double = content.get("orbital_aberration"), content.get("doubles")
    if isinstance(orbit, dict):
        kind = OrbitVelocity if "km_s" in orbit else MeanOrbitVelocity
        content["orbital_aberration"] = _instance(
            kind, {k: tuple(v) if isinstance(v, list) else v for k, v in orbit.items()}
        )
    if isinstance(double, dict):
        content["doubles"] = _instance(Doubles, double)
    corrections: Corrections = _instance(Corrections, content)
    return corrections


def frame_name(corrections: Corrections, date_jyear: float) -> str:
    """Return the name of the frame for display."""
    if corrections.frame == "of_date":
        return f"mean equator and equinox of J{date_jyear:.3f}"
    if corrections.frame == "b1950":
        return f"B1950 (FK4, {'with' if corrections.e_terms else 'without'} E-terms)"
    return "ICRS"


def _check_speed(speed_km_s: float) -> None:
    if not 0 <= speed_km_s <= FASTEST_ORBIT_KM_S:
        raise BadInput(
            "orbital speed is out of range", expected=f"0 to {FASTEST_ORBIT_KM_S:g} km/s", got=f"{speed_km_s:g}"
        )


def _instance(kind: Any, content: JsonObject) -> Any:
    names = {f.name for f in fields(kind)}
    if unknown := set(content) - names:
        raise BadInput("unknown correction", expected=" | ".join(sorted(names)), got=", ".join(sorted(unknown)))
    try:
        return kind(**content)
    except TypeError as error:
        raise BadInput("a correction cannot be read", expected="the values of its parameters", got=str(error)) from None
