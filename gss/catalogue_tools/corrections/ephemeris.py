"""Directions and magnitudes of Sun, Moon and planets, and the Earth's velocity.

The series built into ERFA (Simon et al. 1994 for the planets, Meeus 1998 for the Moon, VSOP2000-based for the Earth)
need no ephemeris file and are accurate to arcseconds. Time is Terrestrial Time as a Julian year. Directions are ICRS,
corrected for light travel time and the observer's position. They do not include aberration, which is applied to the
whole sky in a separate step.
"""

from __future__ import annotations

from dataclasses import dataclass

import erfa  # type: ignore[import-untyped]  # the package has no types
import numpy as np

from gss.catalogue_tools.corrections.corrections import DAYS_PER_YEAR, J2000_JYEAR
from gss.domain.angles import Array, unit_from_ra_dec
from gss.domain.rotation import rotation_z

J2000_JD = 2451545.0
AU_KM = 149_597_870.7
LIGHT_KM_S = 299_792.458
DAY_S = 86_400.0
AU_DAY = AU_KM / DAY_S / LIGHT_KM_S
# TT − UTC since 2017. A further leap second would change the position of the Moon by half an arcsecond.
TT_MINUS_UTC_S = 69.184
SUN_RADIUS_KM = 695_700.0
MOON_RADIUS_KM = 1_737.4
MOON_MEAN_KM = 384_400.0
SUN_V_MAG = -26.74
FULL_MOON_V_MAG = -12.73
PLANETS = ("Mercury", "Venus", "Mars", "Jupiter", "Saturn", "Uranus", "Neptune")
ERFA_NUMBER = (1, 2, 4, 5, 6, 7, 8)
# V at 1 au from Sun and Earth, and a polynomial in the phase angle in degrees (Astronomical Almanac 1984, Meeus ch. 41).
PHASE_LAWS: dict[str, tuple[float, ...]] = {
    "Mercury": (-0.42, 0.0380, -0.000273, 0.000002),
    "Venus": (-4.40, 0.0009, 0.000239, -0.00000065),
    "Mars": (-1.52, 0.016),
    "Jupiter": (-9.40, 0.005),
    "Saturn": (-8.88, 0.044),
    "Uranus": (-7.19,),
    "Neptune": (-6.87,),
}
SATURN_POLE = unit_from_ra_dec(np.radians(40.589), np.radians(83.537))


@dataclass(frozen=True)
class BodyDisc:
    """An extended body: (3,) ICRS direction, angular radius, magnitude V of the lit part, and distance."""

    icrs: Array
    radius_rad: float
    v_mag: float
    distance_km: float


@dataclass(frozen=True)
class Bodies:
    """Solar-system bodies seen from one position.

    ``planets_icrs`` (7, 3), ``planets_v_mag`` (7,) and the distances ``planets_au`` (7,) are in the order of PLANETS.
    ``earth_velocity_c``: (3,) barycentric velocity of the Earth in units of c, ICRS.
    """

    sun: BodyDisc
    moon: BodyDisc
    planets_icrs: Array
    planets_v_mag: Array
    earth_velocity_c: Array
    planets_au: Array


def bodies_at(jyear: float, observer_km: Array | None = None) -> Bodies:
    """Compute Sun, Moon and planets for an observer. ``observer_km``: (3,) position from the Earth's centre, ICRS axes;
    None: the centre."""
    position_au = np.zeros(3) if observer_km is None else np.asarray(observer_km, float) / AU_KM
    helio, bary = erfa.epv00(J2000_JD, _days(jyear))
    sun_au = -helio["p"] - position_au
    moon_travel_days = MOON_MEAN_KM / LIGHT_KM_S / DAY_S
    moon_au = erfa.moon98(J2000_JD, _days(jyear) - moon_travel_days)["p"] - position_au
    named = zip(PLANETS, ERFA_NUMBER, strict=True)
    planets = [_planet(name, number, jyear, helio["p"], position_au) for name, number in named]
    return Bodies(
        _disc(sun_au, SUN_RADIUS_KM, SUN_V_MAG + 5 * np.log10(np.linalg.norm(sun_au))),
        _disc(moon_au, MOON_RADIUS_KM, moon_v_mag(sun_au, moon_au)),
        np.stack([p[0] for p in planets]),
        np.array([p[1] for p in planets]),
        np.asarray(bary["v"] * AU_DAY),
        np.array([p[2] for p in planets]),
    )


def earth_motion(jyear: float) -> tuple[Array, Array]:
    """Return the (3,) barycentric position of the Earth in au and (3,) velocity in units of c, ICRS."""
    _, bary = erfa.epv00(J2000_JD, _days(jyear))
    return np.asarray(bary["p"]), np.asarray(bary["v"] * AU_DAY)


def mean_earth_velocity_c(jyear: float, days: float) -> Array:
    """Return the (3,) mean barycentric velocity of the Earth over ``days`` around ``jyear``, in units of c, computed
    from the chord of its path."""
    if days <= 0:
        return earth_motion(jyear)[1]
    half_yr = days / DAYS_PER_YEAR / 2
    chord_au = earth_motion(jyear + half_yr)[0] - earth_motion(jyear - half_yr)[0]
    return np.asarray(chord_au / days * AU_DAY)


def moon_v_mag(sun_au: Array, moon_au: Array) -> float:
    """Magnitude of the Moon from its distance and phase (Allen 1976 §66)."""
    from_sun = moon_au - sun_au
    phase_deg = float(np.degrees(np.arccos(np.clip(_unit(from_sun) @ _unit(moon_au), -1, 1))))
    distance = float(np.linalg.norm(moon_au)) * AU_KM / MOON_MEAN_KM
    return FULL_MOON_V_MAG + 0.026 * phase_deg + 4e-9 * phase_deg**4 + 5 * float(np.log10(distance))


def teme_from_icrs(jyear: float) -> Array:
    """Return the (3, 3) rotation into SGP4's axes: true equator of date, with x offset from the equinox by the equation
    of the equinoxes."""
    days = _days(jyear)
    of_date = erfa.pnm06a(J2000_JD, days)
    return np.asarray(rotation_z(float(erfa.ee06a(J2000_JD, days))) @ of_date)


def earth_pole_icrs(jyear: float) -> Array:
    """Return the (3,) ICRS direction of the Earth's axis of date."""
    return np.asarray(erfa.pnm06a(J2000_JD, _days(jyear))[2])


def _days(jyear: float) -> float:
    return (jyear - J2000_JYEAR) * DAYS_PER_YEAR


def _unit(vector: Array) -> Array:
    return np.asarray(vector / np.linalg.norm(vector))


def _disc(position_au: Array, radius_km: float, v_mag: float) -> BodyDisc:
    distance_km = float(np.linalg.norm(position_au)) * AU_KM
    return BodyDisc(_unit(position_au), float(np.arcsin(radius_km / distance_km)), float(v_mag), distance_km)


def _planet(name: str, number: int, jyear: float, earth_au: Array, position_au: Array) -> tuple[Array, float, float]:
    """Return ICRS direction, magnitude and distance of a planet at the time the light left it."""
    travel_days = 0.0
    for _ in range(2):
        at_sun = erfa.plan94(J2000_JD, _days(jyear) - travel_days, number)["p"]
        from_earth_au = at_sun - earth_au - position_au
        travel_days = float(np.linalg.norm(from_earth_au)) * AU_DAY
    r, delta = float(np.linalg.norm(at_sun)), float(np.linalg.norm(from_earth_au))
    phase_deg = float(np.degrees(np.arccos(np.clip(_unit(at_sun) @ _unit(from_earth_au), -1, 1))))
    v_mag = 5 * np.log10(r * delta) + np.polyval(PHASE_LAWS[name][::-1], phase_deg)
    if name == "Saturn":
        tilt = abs(float(SATURN_POLE @ _unit(from_earth_au)))
        v_mag += -2.60 * tilt + 1.25 * tilt**2
    return _unit(from_earth_au), float(v_mag), delta
