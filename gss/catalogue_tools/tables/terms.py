"""Derive request parameters from orbit and camera: altitude, baffle angles, orbital velocity, mounting."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gss.catalogue_tools.corrections.correction_switches import MeanOrbitVelocity
from gss.catalogue_tools.envelope.attitude import ORBIT_LAWS, AttitudeLimits, euler_123
from gss.catalogue_tools.envelope.occultation import Occultation
from gss.catalogue_tools.envelope.orbits import EARTH_MU_M3_S2, EARTH_RADIUS_M, OrbitRanges, altitude_of_tle
from gss.catalogue_tools.request import ElementsOrbit, TleOrbit
from gss.domain.angles import Array
from gss.domain.errors import BadInput
from gss.domain.profiles import profile

Orbit = ElementsOrbit | TleOrbit | None


def altitude_m(orbit: Orbit, given_m: float | None) -> float | None:
    """Return the given altitude, otherwise that of the TLE or the elements; None if none is known."""
    if given_m is not None:
        return given_m
    if isinstance(orbit, TleOrbit):
        return altitude_of_tle(orbit.text)
    return orbit.altitude_m if orbit is not None else None


def occultation_of(
    profile_name: str,
    height_m: float | None,
    *,
    earth: bool,
    margin_rad: float = 0.0,
    sun: bool = False,
    sun_rad: float | None = None,
    moon: bool = False,
    moon_rad: float | None = None,
) -> Occultation:
    """Return what hides the sky: Earth, Sun, Moon.

    Baffle angles that are not given are the camera's: the Sun's limit for the Sun; for the Moon, whose stray light is
    negligible compared with the Sun's, the angle within which its light falls directly on the lens. BadInput if
    ``earth`` and no altitude is known.
    """
    if earth and height_m is None:
        raise BadInput(
            "how much the Earth hides needs the altitude",
            expected="an altitude, or a TLE",
            got="neither",
            hint="give the orbit's altitude",
        )
    baffle = profile(profile_name).baffle
    return Occultation(
        altitude_m=height_m if earth else None,
        earth_margin_rad=margin_rad if earth else 0.0,
        sun_rad=(baffle.sun_limit_rad if sun_rad is None else sun_rad) if sun else 0.0,
        moon_rad=(baffle.blind_rad if moon_rad is None else moon_rad) if moon else 0.0,
    )


def orbital_velocity(attitude: AttitudeLimits | None, normal: Array, height_m: float | None) -> MeanOrbitVelocity:
    """Velocity for orbital aberration on a circular orbit, at the time each star passes the middle of the field.

    ``normal``: (3,) ICRS pole of the orbit.
    """
    if height_m is None:
        raise BadInput("orbital aberration needs the orbit's altitude", expected="an altitude, or a TLE", got="neither")
    speed_km_s = float(np.sqrt(EARTH_MU_M3_S2 / (EARTH_RADIUS_M + height_m))) / 1000
    pole = (float(normal[0]), float(normal[1]), float(normal[2]))
    if attitude is None or attitude.pointing not in ORBIT_LAWS:
        return MeanOrbitVelocity(speed_km_s, pole)
    middle = euler_123((attitude.low + attitude.high) / 2)
    boresight = (attitude.cam_from_body @ middle)[2]
    return MeanOrbitVelocity(speed_km_s, pole, (float(boresight[0]), float(boresight[1]), float(boresight[2])))


def pole_of(planes: OrbitRanges | None) -> Array:
    """(3,) ICRS pole of the middle plane."""
    if planes is None:
        raise BadInput("orbital aberration needs an orbit", expected="orbital elements or a TLE", got="no orbit")
    i, raan = float(np.mean(planes.inclination_rad)), float(np.mean(planes.raan_rad))
    return np.array([np.sin(raan) * np.sin(i), -np.cos(raan) * np.sin(i), np.cos(i)])


def mounting_of(body_from_cam: Sequence[float] | None, turns_deg: Sequence[float] | None) -> tuple[float, ...] | None:
    """Return the mounting as nine numbers by rows; None if neither argument is given (the pointing law's default applies).

    ``turns_deg``, instead of ``body_from_cam``: rotations about x, then y, then z that take the body's axes to the
    camera's (the order of Jacobs 1995 eq. 1.13).
    """
    if turns_deg is None:
        return None if body_from_cam is None else tuple(float(x) for x in body_from_cam)
    if body_from_cam is not None:
        raise BadInput("two mountings were given", expected="either nine numbers or three turns", got="both")
    if not np.isfinite(turns_deg).all():
        raise BadInput("a turn of the mounting is not a number", expected="three angles", got=str(list(turns_deg)))
    return tuple(float(x) for x in euler_123(np.radians(turns_deg)).T.ravel())
