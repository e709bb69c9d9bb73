"""Lost-in-space identification with a known camera. Pairs of the distance table are supported by third and fourth stars
and verified on the whole field.

After Mortari, Samaan, Bruccoleri & Junkins 2004 (pyramid), with two changes: all stars that the other detections can be
are examined together (:mod:`~gss.pipeline.identify.anchor_search`), and a candidate is accepted by its false-match
probability instead of by its fourth star alone.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from gss.domain.camera import Camera
from gss.pipeline.identify import anchor_search
from gss.pipeline.identify.false_match import not_credible
from gss.pipeline.identify.verify import Evidence, FrameDetections, SkyCatalogue, verify, without_one
from gss.pipeline.kernels import ListLoops, kernels
from gss.skytables.pairs import DistanceTable

ACCEPT = 1e-6
MAX_STARS, FEW_STARS = 120, 20
CROWDED = 27.0
"""Largest average number of pairs of a detection that a catalogue star can be part of. With more, unrelated stars often support
a pair, so only the brightest detections are examined, but at least ``FEW_STARS``."""
SUPPORT = 2
MIN_MATCHED = 4  # three stars are never sufficient evidence over the whole sky, even with a low false-match probability


@dataclass(frozen=True)
class PyramidMatch:
    """Result of the identification: the accepted evidence, or None and the reason. ``hypotheses``: number of hypotheses in
    the false-match probability of the evidence; without evidence, number of examined ones."""

    evidence: Evidence | None
    hypotheses: int
    reason: str = ""


def identify_lost(
    field: FrameDetections,
    sky: SkyCatalogue,
    table: DistanceTable,
    camera: Camera,
    *,
    scale_error: float = 0.0,
    accept: float = ACCEPT,
    support: int = SUPPORT,
    budget: int = anchor_search.MAX_HYPOTHESES,
    only_first: bool = False,
    fast: bool | None = None,
) -> PyramidMatch:
    """Identify a field without prior attitude.

    ``scale_error``: relative uncertainty of distances from the camera's calibration, added to the centroid errors.
    ``support``: minimum number of further detections that must fit a pair before it is verified.
    ``budget``: number of hypotheses, i.e. of catalogue pairs that pairs of detections can be, after which no further
    anchor is examined. ``only_first``: search only the brightest group of each size, for fields of which most are not
    solved. ``fast``: see :func:`gss.pipeline.kernels.kernels`.
    """
    n = min(len(field), MAX_STARS, _uncrowded(field, sky, camera, scale_error))
    if n < MIN_MATCHED:
        return PyramidMatch(None, 0, f"{counted(len(field))} found: at least {MIN_MATCHED} are needed without a hint")
    loops = kernels(fast).lists
    if loops is not None:
        return _compiled(field, sky, table, camera, n, scale_error, accept, support, budget, only_first, loops)
    search = anchor_search.AnchorSearch(field, sky, table, n, scale_error, support, budget, only_first)
    best: Evidence | None = None
    for trial in search.run():
        rows, stars = np.array(trial.rows), np.array(trial.stars)
        evidence = verify(field, sky, camera, rows=rows, stars=stars, hypotheses=trial.rank)
        if evidence is None or len(evidence.rows) < MIN_MATCHED:
            continue
        if evidence.false_match_probability <= accept:
            return PyramidMatch(without_one(field, sky, camera, rows, evidence, trial.rank), trial.rank)
        if best is None or evidence.false_match_probability < best.false_match_probability:
            best = evidence
    probability = math.nan if best is None else best.false_match_probability
    why = (0 if best is None else len(best.rows), probability)
    reason = _too_long(search.hypotheses, *why) if search.is_too_long else _why_not(field, *why, accept)
    return PyramidMatch(None, search.hypotheses, reason)


def _uncrowded(field: FrameDetections, sky: SkyCatalogue, camera: Camera, scale_error: float) -> int:
    """Return the largest number of detections with at most ``CROWDED`` pairs, but at least ``FEW_STARS``. The number of pairs
    is estimated for stars distributed evenly over the sky and the largest angle from the boresight."""
    angle_rad = min(camera.half_diagonal_rad, np.pi / 2)
    tolerance_rad = anchor_search.TOLERANCE_SIGMA * math.sqrt(2) * field.typical_sigma_px * camera.pixel_rad
    pairs_per_detection = len(sky) * math.sin(angle_rad) * (tolerance_rad + scale_error * angle_rad)
    return (
        max(FEW_STARS, int(CROWDED / pairs_per_detection)) if pairs_per_detection * len(field) > CROWDED else len(field)
    )


def _compiled(
    field: FrameDetections,
    sky: SkyCatalogue,
    table: DistanceTable,
    camera: Camera,
    brightest: int,
    scale_error: float,
    accept: float,
    support: int,
    budget: int,
    only_first: bool,
    loops: ListLoops,
) -> PyramidMatch:
    rows, stars, turn = np.empty(len(field), np.int64), np.empty(len(field), np.int64), np.empty((3, 3))
    count, predicted, probability, hypotheses, is_too_long = loops.find(
        field.arrays,
        sky.arrays,
        (table.first, table.second, table.distance_rad),
        loops.camera_numbers(camera),
        brightest,
        scale_error,
        anchor_search.TOLERANCE_SIGMA,
        anchor_search.limits(budget),
        support,
        accept,
        MIN_MATCHED,
        only_first,
        rows,
        stars,
        turn,
    )
    if count > 0:
        return PyramidMatch(Evidence(rows[:count], stars[:count], turn, predicted, probability), hypotheses)
    reason = _too_long(hypotheses, -count, probability) if is_too_long else _why_not(field, -count, probability, accept)
    return PyramidMatch(None, hypotheses, reason)


def counted(stars: int) -> str:
    """Return the count with its noun: "1 star", "5 stars"."""
    return f"{stars} star{'' if stars == 1 else 's'}"


def _why_not(field: FrameDetections, matched: int, probability: float, accept: float) -> str:
    """Return the reason for the failure. ``matched``: number of stars of the best candidate, 0 without a candidate."""
    if not matched:
        return f"no four of the {len(field)} stars fit the catalogue: another camera than stated, or too few catalogue stars"
    return not_credible(matched, len(field), probability, accept)


def _too_long(hypotheses: int, matched: int, probability: float) -> str:
    tail = f"; best false-match probability {probability:.1e}" if matched else ""
    return f"no match after {hypotheses} hypotheses, the limit{tail}"
