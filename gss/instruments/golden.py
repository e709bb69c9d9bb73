"""Factory catalogue (golden bank): the complete sky down to the camera's magnitude limit.

The simulator writes it to flash. The ground uses it to identify the stars of the golden bank.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from gss.catalogue_tools.onboard import encode, format_of, frame_of, reduced_catalogue, tables_for
from gss.catalogue_tools.sources.hipparcos import load_stars, propagate
from gss.domain.camera_profile import CameraProfile
from gss.domain.stars import Ids, StarTable
from gss.pipeline.chains.oersted_match import limit_mag
from gss.pipeline.chains.oersted_parameters import uncertainty_rad
from gss.skytables.pairs import DistanceTable, distance_table

GOLDEN_EPOCH_JYEAR = 2025.0
MIN_PAIR_RAD = 0.0044
# The pointings are half as dense as those of the survey in the document. The unit therefore boots faster, but about 1 %
# of the stars are lost.
SURVEY_STEP_RAD = float(np.radians(2.0))


@dataclass(frozen=True)
class Golden:
    """Bank image and the (n,) Hipparcos numbers of its rows."""

    image: bytes
    hip: Ids


def build_golden(profile: CameraProfile, capacity_bytes: int) -> Golden:
    """Return a catalogue of all stars down to the magnitude limit (Erlank 2013 §4.3.2: V 3.8) and all pairs that fit in
    one frame.

    The format and the tables are those of the unit; the result does not depend on the machine. If the bank is too
    small, the maximum pair distance is reduced first, then the magnitude limit.
    """
    faint_mag = min(profile.sensor.faint_limit_mag, 8.0)
    form = profile.formats[0]
    while True:
        stars = propagate(load_stars(faint_mag), GOLDEN_EPOCH_JYEAR)
        if len(stars) <= format_of(form).most_stars:
            for image in _images(form, stars, profile):
                if len(image) <= capacity_bytes:
                    return Golden(image, stars.hip)
        faint_mag -= 0.25


def _images(form: str, stars: StarTable, profile: CameraProfile) -> Iterator[bytes]:
    """Yield bank images of a star list, from largest to smallest."""
    camera = profile.camera
    reduced = reduced_catalogue(stars, frame_of(camera, SURVEY_STEP_RAD)) if form == "far-mst" else None
    for share in (1.0, 0.9, 0.8) if format_of(form).pairs else (1.0,):
        catalogue_tables = tables_for(
            form,
            stars,
            _pairs(form, stars, share * camera.diagonal_rad),
            camera,
            limit_mag=limit_mag(stars.v_mag, profile),
            uncertainty_rad=uncertainty_rad(profile),
            reduced=reduced,
        )
        yield encode(stars, catalogue_tables.distances, form, profile.name, tables=catalogue_tables.tables)


def _pairs(form: str, stars: StarTable, max_rad: float) -> DistanceTable:
    if format_of(form).pairs:
        return distance_table(stars, MIN_PAIR_RAD, max_rad)
    none = np.empty(0, np.int32)
    return DistanceTable(none, none, np.empty(0), MIN_PAIR_RAD, max_rad)
