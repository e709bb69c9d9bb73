"""The factory catalogue: the whole sky to the camera's faint limit. The simulator burns it, the ground knows its names."""

from __future__ import annotations

from dataclasses import dataclass

from gss.catalogue_tools.distances import distance_table
from gss.catalogue_tools.hipparcos import load_stars, propagate
from gss.catalogue_tools.onboard import encode
from gss.domain.profiles import CameraProfile
from gss.domain.stars import Ids

GOLDEN_EPOCH_JYEAR = 2025.0
MIN_PAIR_RAD = 0.0044


# Whose matching goes by magnitudes, which only the sunsat format has. All read CubeStar's as well.
OWN_FORMATS = {"sunsat": "sunsat", "oersted": "sunsat", "far_mst": "sunsat"}


def bank_formats(profile_name: str) -> tuple[str, ...]:
    """On-board formats that a unit reads, its own first."""
    own = OWN_FORMATS.get(profile_name, "cubestar")
    return (own,) if own == "cubestar" else (own, "cubestar")


@dataclass(frozen=True)
class Golden:
    """Bank image and the (n,) Hipparcos numbers of its rows."""

    image: bytes
    hip: Ids


def build_golden(profile: CameraProfile, capacity_bytes: int) -> Golden:
    """All stars to the faint limit (Erlank 2013 §4.3.2: V 3.8), all pairs that fit one frame; the same on any machine.

    In the unit's own format. Where the bank is too small the table ends at a shorter distance, and then at brighter stars.
    """
    faint_mag = min(profile.sensor.faint_limit_mag, 8.0)
    while True:
        stars = propagate(load_stars(faint_mag), GOLDEN_EPOCH_JYEAR)
        for share in (1.0, 0.9, 0.8):
            table = distance_table(stars, MIN_PAIR_RAD, share * profile.camera.diagonal_rad)
            image = encode(stars, table, bank_formats(profile.name)[0], profile.name)
            if len(image) <= capacity_bytes:
                return Golden(image, stars.hip)
        faint_mag -= 0.25
