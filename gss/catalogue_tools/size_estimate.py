"""Estimate the number of pairs and bytes of a star selection before the tables are made."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from gss.catalogue_tools.onboard import encode, format_of, frame_of, image_bytes, reduced_catalogue, tables_for
from gss.catalogue_tools.plan import BuildPlan
from gss.domain.angles import Array
from gss.domain.camera import Camera
from gss.domain.stars import StarTable
from gss.skytables.bank import ReducedFrame
from gss.skytables.pairs import DistanceTable

PAIR_SAMPLE = 800
# Up to this number of stars, building triplets and links is fast, so the size is exact. Above it, the size is
# extrapolated.
EXACT_SIZE_STARS = 6000
# A reduced catalogue with these steps takes about a tenth of the time of 1° steps. The number of stars falls almost
# linearly with the step.
COARSE_STEPS_RAD = tuple(float(np.radians(step)) for step in (3.0, 4.0))
REDUCED_HEAD_BYTES = 8 + 16
SECTION_HEAD_BYTES = 8


def estimated(build_plan: BuildPlan, stars: StarTable) -> tuple[int, int]:
    """Return (pairs, bytes) of the image of ``stars``.

    Pairs are counted for up to 800 stars. For more stars the count is scaled up from a sample of 800. With a reduced
    catalogue, only pairs of its stars are counted. For a format without pairs the count is 0, and the size is exact up
    to 6000 stars because the image is built.
    """
    request = build_plan.request
    name, frame, pairs = (
        request.format_name,
        frame_for(request.format_name, build_plan.profile.camera, request.reduced),
        0,
    )
    if not format_of(name).pair_bytes:
        if 2 <= len(stars) <= EXACT_SIZE_STARS:
            return 0, _built_bytes(build_plan, stars)
    elif frame is None:
        pairs = estimate_pairs(stars.icrs, request.pair_min_rad, build_plan.pair_max_rad)
    else:
        pairs = reduced_pairs(stars, frame, request.pair_min_rad, build_plan.pair_max_rad)
    return pairs, image_bytes(name, len(stars), pairs) + _reduced_bytes(name, len(stars), frame)


def frame_for(format_name: str, camera: Camera, requested: ReducedFrame | None) -> ReducedFrame | None:
    """Return the frame of a format's reduced catalogue; None if the format has no reduced catalogue."""
    return frame_of(camera) if requested is None and format_name == "far-mst" else requested


def reduced_pairs(selected: StarTable, frame: ReducedFrame, min_rad: float, max_rad: float) -> int:
    """Estimate the number of pairs of stars in the reduced catalogue.

    The number is computed directly if the frame's step is coarse, otherwise extrapolated linearly from two coarser
    steps.
    """
    counts = []
    for step_rad in COARSE_STEPS_RAD if frame.step_rad < COARSE_STEPS_RAD[0] else (frame.step_rad,):
        stars = selected.take(reduced_catalogue(selected, replace(frame, step_rad=step_rad)).kept)
        counts.append(estimate_pairs(stars.icrs, min_rad, max_rad))
    if len(counts) == 1:
        return counts[0]
    fine, coarse = counts
    slope = (fine - coarse) / (COARSE_STEPS_RAD[1] - COARSE_STEPS_RAD[0])
    drawn = fine + max(0.0, slope) * (COARSE_STEPS_RAD[0] - frame.step_rad)
    return int(min(round(drawn), estimate_pairs(selected.icrs, min_rad, max_rad)))


def searched(build_plan: BuildPlan, stars: StarTable) -> StarTable:
    """Return an approximate list of the stars that the device searches: all stars, or the stars of a reduced catalogue
    computed with a coarse step."""
    frame = frame_for(build_plan.request.format_name, build_plan.profile.camera, build_plan.request.reduced)
    if frame is None:
        return stars
    step_rad = max(frame.step_rad, COARSE_STEPS_RAD[0])
    return stars.take(reduced_catalogue(stars, replace(frame, step_rad=step_rad)).kept)


def estimate_pairs(unit: Array, min_rad: float, max_rad: float) -> int:
    """Estimate the number of pairs within the limits: counted for up to 800 stars, otherwise scaled up from 800 evenly
    chosen stars."""
    n = len(unit)
    if n < 2:
        return 0
    sample = unit[np.unique(np.linspace(0, n - 1, min(n, PAIR_SAMPLE)).astype(int))]
    tree = cKDTree(unit)
    near, far = 2 * np.sin(min_rad / 2), 2 * np.sin(min(max_rad, np.pi) / 2)
    within = tree.query_ball_point(sample, far, return_length=True) - tree.query_ball_point(
        sample, near * (1 - 1e-12), return_length=True
    )
    # Both counts include the star itself, so it cancels in the difference.
    return round(float(within.sum()) * n / len(sample) / 2)


def _built_bytes(build_plan: BuildPlan, stars: StarTable) -> int:
    none = np.empty(0, np.int32)
    nothing = DistanceTable(none, none, np.empty(0), build_plan.request.pair_min_rad, build_plan.pair_max_rad)
    name = build_plan.request.format_name
    catalogue_tables = tables_for(
        name, stars, nothing, build_plan.profile.camera, reduced=_coarser(build_plan.request.reduced)
    )
    return len(encode(stars, catalogue_tables.distances, name, build_plan.profile.name, tables=catalogue_tables.tables))


def _coarser(frame: ReducedFrame | None) -> ReducedFrame | None:
    """Return the frame with a coarser step. The size of the list in bytes does not depend on the number of kept
    stars."""
    return None if frame is None else replace(frame, step_rad=max(frame.step_rad, COARSE_STEPS_RAD[1]))


def _reduced_bytes(name: str, stars: int, frame: ReducedFrame | None) -> int:
    if frame is None:
        return 0
    size = REDUCED_HEAD_BYTES + -(-stars // 8)
    return size + -size % 4 + (0 if format_of(name).sections else SECTION_HEAD_BYTES)
