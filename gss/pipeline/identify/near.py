"""Identification with a prior attitude (assisted and tracking modes). Each detection has only few candidates.
Candidates of different detections that are consistent vote for each other."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gss.domain.angles import Array
from gss.domain.camera import Camera
from gss.pipeline.identify.false_match import not_credible
from gss.pipeline.identify.pyramid import PyramidMatch, counted
from gss.pipeline.identify.verify import Evidence, FrameDetections, SkyCatalogue, verify, without_one
from gss.pipeline.kernels import ListLoops, kernels

Rows = NDArray[np.intp]
Mask = NDArray[np.bool_]

TOLERANCE_SIGMA = 3.5
ACCEPT = 1e-4  # less strict than without a hint, because the result must also agree with the hint
MAX_STARS = 40
MAX_CANDIDATES = 700
TRIES = 6
FEW_CANDIDATES = 1  # reason code of the compiled search; other codes: no three stars agree
FEW = "no catalogue stars near the positions expected from the hint"
NO_THREE = "no three stars agree with the catalogue near the hint"


@dataclass(frozen=True)
class BoundedPrior:
    """Prior attitude and its maximum error, rad."""

    cam_from_icrs: Array
    radius_rad: float


def identify_near(
    field: FrameDetections,
    sky: SkyCatalogue,
    camera: Camera,
    hint: BoundedPrior,
    *,
    accept: float = ACCEPT,
    fast: bool | None = None,
) -> PyramidMatch:
    """Identify with a prior attitude. Candidates are (detection, catalogue star) pairs within the radius; consistent pairs vote.

    ``fast``: see :func:`gss.pipeline.kernels.kernels`.
    """
    n = min(len(field), MAX_STARS)
    if n < 3:
        return PyramidMatch(None, 0, f"{counted(len(field))} found: at least 3 are needed near a known attitude")
    loops = kernels(fast).lists
    if loops is not None:
        return _compiled(field, sky, camera, hint, n, accept, loops)
    reach = np.cos(min(camera.half_diagonal_rad + hint.radius_rad, np.pi))
    local = np.flatnonzero(sky.icrs @ hint.cam_from_icrs[2] > reach)
    expected = sky.icrs[local] @ hint.cam_from_icrs.T
    chord2 = 2 - 2 * field.unit[:n] @ expected.T
    observed, reference = np.nonzero(chord2 < (2 * np.sin(hint.radius_rad / 2) + 3 * field.sigma_rad[:n, None]) ** 2)
    if len(observed) > MAX_CANDIDATES:
        observed, reference = observed[:MAX_CANDIDATES], reference[:MAX_CANDIDATES]
    if len(observed) < 3:
        return PyramidMatch(None, len(observed), FEW)
    agree = _agreement(field, observed, field.unit[observed], expected[reference], reference)
    hypotheses = int(agree.sum()) // 2
    best: Evidence | None = None
    for _ in range(TRIES):
        votes = agree.sum(axis=1)
        p = int(votes.argmax())
        if votes[p] < 2:
            break
        common = agree & agree[p]
        q = int(np.where(agree[p], common.sum(axis=1), -1).argmax())
        members = np.flatnonzero(agree[p] & agree[q])
        if not len(members):
            agree[p, q] = agree[q, p] = False
            continue
        side, distances = (
            field.unit[observed[q]] - field.unit[observed[p]],
            field.unit[observed[members]] - field.unit[observed[p]],
        )
        # square of twice the area of the triangle
        area2 = (side @ side) * (distances * distances).sum(1) - (distances @ side) ** 2
        trio = np.array([p, q, members[area2.argmax()]])
        rows, stars, tried = observed[trio], local[reference[trio]], max(hypotheses, 1)
        evidence = verify(field, sky, camera, rows=rows, stars=stars, hypotheses=tried)
        if evidence is not None and evidence.false_match_probability <= accept:
            # A better match that is not near the hint rejects this candidate as well.
            evidence = without_one(field, sky, camera, rows, evidence, tried)
        if evidence is not None and _is_near(evidence, hint):
            if evidence.false_match_probability <= accept:
                return PyramidMatch(evidence, hypotheses)
            if best is None or evidence.false_match_probability < best.false_match_probability:
                best = evidence
        agree[p] = agree[:, p] = False
    if best is None:
        return PyramidMatch(None, hypotheses, NO_THREE)
    return PyramidMatch(None, hypotheses, _too_weak(len(best.rows), field, best.false_match_probability, accept))


def _too_weak(matched: int, field: FrameDetections, probability: float, accept: float) -> str:
    return not_credible(matched, len(field), probability, accept, "near the hint")


def _compiled(
    field: FrameDetections,
    sky: SkyCatalogue,
    camera: Camera,
    hint: BoundedPrior,
    brightest: int,
    accept: float,
    loops: ListLoops,
) -> PyramidMatch:
    rows, stars, turn = np.empty(len(field), np.int64), np.empty(len(field), np.int64), np.empty((3, 3))
    count, predicted, probability, hypotheses, reason = loops.find_near(
        field.arrays,
        sky.arrays,
        loops.camera_numbers(camera),
        np.ascontiguousarray(hint.cam_from_icrs, float),
        float(hint.radius_rad),
        math.cos(min(camera.half_diagonal_rad + hint.radius_rad, math.pi)),
        brightest,
        TOLERANCE_SIGMA,
        MAX_CANDIDATES,
        TRIES,
        accept,
        rows,
        stars,
        turn,
    )
    if count > 0:
        return PyramidMatch(Evidence(rows[:count], stars[:count], turn, predicted, probability), hypotheses)
    if reason:
        return PyramidMatch(None, hypotheses, FEW if reason == FEW_CANDIDATES else NO_THREE)
    return PyramidMatch(None, hypotheses, _too_weak(-count, field, probability, accept))


def _agreement(field: FrameDetections, observed: Rows, unit: Array, expected: Array, reference: Rows) -> Mask:
    """Return the (k, k) mask of candidate pairs with the right separation and different stars."""
    variance = field.sigma_rad[observed] ** 2
    tolerance = TOLERANCE_SIGMA * np.sqrt(variance[:, None] + variance)
    a, b = _distances(np.stack([unit, expected]))
    return np.asarray((np.abs(a - b) < tolerance) & (observed[:, None] != observed) & (reference[:, None] != reference))


def _distances(unit: Array) -> Array:
    """Return the (…, k, k) angles between (…, k, 3) directions."""
    # The rounding error of the chord from the Gram matrix is far below any centroid error.
    half2 = 0.5 - 0.5 * (unit @ unit.swapaxes(-1, -2))
    return np.asarray(2 * np.arcsin(np.sqrt(np.minimum(np.maximum(half2, 0.0), 1.0))))


def _is_near(evidence: Evidence, hint: BoundedPrior) -> bool:
    cosine = (float((evidence.cam_from_icrs * hint.cam_from_icrs).sum()) - 1) / 2
    return math.acos(min(max(cosine, -1.0), 1.0)) <= 2 * hint.radius_rad + 0.01
