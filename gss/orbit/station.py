"""Ground stations: position, horizon mask and directions to a spacecraft."""

from __future__ import annotations

import math
from dataclasses import dataclass

import erfa  # type: ignore[import-untyped]  # the package has no types
import numpy as np

from gss.domain.angles import Array
from gss.domain.errors import BadInput

MAX_MASK_POINTS = 360
MIN_HEIGHT_M, MAX_HEIGHT_M = -500.0, 9000.0
WGS84 = 1
"""Identifier of the ellipsoid in ERFA."""
Mask = tuple[tuple[float, float], ...]


@dataclass(frozen=True)
class GroundStation:
    """Ground station with its geodetic position on WGS-84.

    ``mask``: points (azimuth, elevation) of the horizon in radians, sorted by azimuth, which is measured from north
    towards east. Elevations are interpolated linearly over the full circle. An empty mask is a flat horizon. A
    spacecraft is in view if it is above the mask and above ``min_elevation_rad``.
    """

    name: str
    latitude_rad: float
    longitude_rad: float
    height_m: float
    min_elevation_rad: float = 0.0
    mask: Mask = ()

    @property
    def position_km(self) -> Array:
        """(3,) position in Earth-fixed axes, km."""
        return np.asarray(erfa.gd2gc(WGS84, self.longitude_rad, self.latitude_rad, self.height_m)) / 1000.0

    @property
    def local_from_fixed(self) -> Array:
        """(3, 3) rotation from Earth-fixed axes to east, north, up (geodetic)."""
        sl, cl = math.sin(self.longitude_rad), math.cos(self.longitude_rad)
        sp, cp = math.sin(self.latitude_rad), math.cos(self.latitude_rad)
        return np.array([[-sl, cl, 0.0], [-sp * cl, -sp * sl, cp], [cp * cl, cp * sl, sp]])

    def look(self, fixed_km: Array) -> tuple[Array, Array, Array]:
        """Return (n,) azimuths [0, 2π), elevations and ranges in km of (n, 3) Earth-fixed positions, without
        refraction."""
        east, north, up = self.local_from_fixed @ (np.asarray(fixed_km) - self.position_km).T
        azimuth, elevation = np.arctan2(east, north) % (2 * np.pi), np.arctan2(up, np.hypot(east, north))
        return azimuth, elevation, np.sqrt(east**2 + north**2 + up**2)

    def horizon_rad(self, azimuth_rad: Array) -> Array:
        """Return the (n,) elevations above which a spacecraft is in view at (n,) azimuths."""
        if not self.mask:
            return np.full(np.shape(azimuth_rad), self.min_elevation_rad, float)
        azimuths, elevations = np.array(self.mask).T
        horizon = np.interp(azimuth_rad, azimuths, elevations, period=2 * np.pi)
        return np.asarray(np.maximum(horizon, self.min_elevation_rad))


def checked_station(station: GroundStation) -> GroundStation:
    """Return the station if its values are valid. Raises BadInput that names the invalid value."""
    _within("latitude", math.degrees(station.latitude_rad), -90.0, 90.0, "°")
    _within("longitude", math.degrees(station.longitude_rad), -180.0, 180.0, "°")
    _within("height", station.height_m, MIN_HEIGHT_M, MAX_HEIGHT_M, " m")
    _within("minimum elevation", math.degrees(station.min_elevation_rad), 0.0, 89.0, "°")
    if len(station.mask) > MAX_MASK_POINTS:
        raise BadInput(
            "the horizon mask has too many points", expected=f"at most {MAX_MASK_POINTS}", got=str(len(station.mask))
        )
    previous_deg = -1.0
    for azimuth_rad, elevation_rad in station.mask:
        azimuth_deg = math.degrees(azimuth_rad)
        _within("azimuth of the mask", azimuth_deg, 0.0, 359.999, "°")
        _within("elevation of the mask", math.degrees(elevation_rad), -10.0, 89.0, "°")
        if azimuth_deg <= previous_deg:
            raise BadInput(
                "the azimuths of the horizon mask do not increase",
                expected=f"an azimuth above {previous_deg:g}°",
                got=f"{azimuth_deg:g}°",
                hint="Sort the points by azimuth, and use each azimuth only once.",
            )
        previous_deg = azimuth_deg
    return station


def _within(quantity: str, value: float, low: float, high: float, unit: str) -> None:
    if not (math.isfinite(value) and low - 1e-9 <= value <= high + 1e-9):
        raise BadInput(
            f"{quantity} of the station is out of range",
            expected=f"{low:g}{unit} to {high:g}{unit}",
            got=f"{value:g}{unit}",
        )
