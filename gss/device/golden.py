"""The factory catalogue: the whole sky to the camera's faint limit. The simulator burns it, the ground knows its names."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from gss.catalogue_tools.onboard import encode, format_of, frame_of, own_format, reduced_catalogue, tables_for
from gss.catalogue_tools.sources.hipparcos import load_stars, propagate
from gss.catalogue_tools.tables.distances import distance_table
from gss.domain.profiles import CameraProfile
from gss.domain.stars import DistanceTable, Ids, StarTable
from gss.pipeline.chains.oersted_match import limit_mag
from gss.pipeline.chains.oersted_parameters import uncertainty_rad

GOLDEN_EPOCH_JYEAR = 2025.0
MIN_PAIR_RAD = 0.0044
# Half as dense as the document's survey: a unit boots faster, and a percent of the stars is lost.
SURVEY_STEP_RAD = float(np.radians(2.0))


# By profile, beside its own: a chain works best from its own tables, and makes them from what the other formats have. Sunsat's
# matching goes by magnitudes, which CubeStar's format lacks; a unit reads that one all the same.
OTHERS_OF = {
    "sunsat": ("sunsat-5", "cubestar"),
    "oersted": ("sunsat", "cubestar"),
    "far_mst": ("sunsat", "cubestar"),
    "aim": ("sunsat", "cubestar"),
}
# Read, but not matched from: Sunsat's matching needs magnitudes.
LACKING = {"sunsat": ("cubestar",)}


def bank_formats(profile_name: str) -> tuple[str, ...]:
    """On-board formats that a unit reads, its own first."""
    return (own_format(profile_name), *OTHERS_OF.get(profile_name, ()))


def matching_formats(profile_name: str) -> tuple[str, ...]:
    """Those of :func:`bank_formats` that the unit's matching finds all it needs in."""
    return tuple(name for name in bank_formats(profile_name) if name not in LACKING.get(profile_name, ()))


@dataclass(frozen=True)
class Golden:
    """Bank image and the (n,) Hipparcos numbers of its rows."""

    image: bytes
    hip: Ids


def build_golden(profile: CameraProfile, capacity_bytes: int) -> Golden:
    """All stars to the faint limit (Erlank 2013 §4.3.2: V 3.8), all pairs that fit one frame; the same on any machine.

    In the unit's own format and with its own tables. Where the bank is too small the table of pairs ends at a shorter distance,
    and then at brighter stars.
    """
    faint_mag = min(profile.sensor.faint_limit_mag, 8.0)
    form = bank_formats(profile.name)[0]
    while True:
        stars = propagate(load_stars(faint_mag), GOLDEN_EPOCH_JYEAR)
        if len(stars) <= format_of(form).most_stars:
            for image in _images(form, stars, profile):
                if len(image) <= capacity_bytes:
                    return Golden(image, stars.hip)
        faint_mag -= 0.25


def _images(form: str, stars: StarTable, profile: CameraProfile) -> Iterator[bytes]:
    """Images of a star list, the largest first."""
    camera = profile.camera
    reduced = reduced_catalogue(stars, frame_of(camera, SURVEY_STEP_RAD)) if form == "far-mst" else None
    for share in (1.0, 0.9, 0.8) if format_of(form).pairs else (1.0,):
        own = tables_for(
            form,
            stars,
            _pairs(form, stars, share * camera.diagonal_rad),
            camera,
            limit_mag=limit_mag(stars.v_mag, profile),
            uncertainty_rad=uncertainty_rad(profile),
            reduced=reduced,
        )
        yield encode(stars, own.distances, form, profile.name, tables=own.tables)


def _pairs(form: str, stars: StarTable, max_rad: float) -> DistanceTable:
    if format_of(form).pairs:
        return distance_table(stars, MIN_PAIR_RAD, max_rad)
    none = np.empty(0, np.int32)
    return DistanceTable(none, none, np.empty(0), MIN_PAIR_RAD, max_rad)
