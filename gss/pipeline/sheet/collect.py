"""Conversion of results of single frames to the input of the performance sheet."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from gss.domain.angles import Array
from gss.domain.camera import Camera
from gss.domain.results import SolveResult, Verdict
from gss.domain.rotation import turn_between
from gss.domain.stars import StarTable
from gss.pipeline.rejected_stars import SeenStars, identified_stars, reach_of, rejected_stars
from gss.pipeline.score import Score
from gss.pipeline.sheet.spatial import StarSightings
from gss.pipeline.sheet.trials import Trials

BLOCK_PX = 2.0
"""Maximum motion of the image within a block of frames. Within a block, stars stay at nearly the same pixels."""


def star_sightings(
    results: Sequence[SolveResult | None], camera: Camera, apparent: Sequence[StarTable] = ()
) -> StarSightings | None:
    """Collect the identified stars of frames in order of time. None if no frame was solved.

    ``apparent``: apparent places of the stars of each frame. With them, the stars that the chain rejected are added with
    weight 0; see :mod:`gss.pipeline.rejected_stars`.
    """
    frames: list[NDArray[np.intp]] = []
    parts: list[SeenStars] = []
    attitude = np.full((len(results), 4), np.nan)
    reach_px = reach_of(results) if apparent else 0.0
    for k, result in enumerate(results):
        if result is None or result.matches is None or result.attitude is None or not len(result.matches):
            continue
        m = result.matches
        seen = identified_stars(result, m)
        if apparent:
            seen = seen.with_others(rejected_stars(result, apparent[k], reach_px))
        parts.append(seen)
        frames.append(np.full(len(seen.hip), k, np.intp))
        attitude[k] = result.attitude.quaternion
    if not parts:
        return None
    return StarSightings(
        np.concatenate(frames),
        np.concatenate([p.pixels for p in parts]),
        np.concatenate([p.residual_px for p in parts]),
        np.concatenate([p.weight for p in parts]),
        np.concatenate([p.hip for p in parts]).astype(np.int32),
        pointing_blocks(attitude, camera),
    )


def pointing_blocks(attitude: Array, camera: Camera) -> NDArray[np.intp]:
    """Return an (n,) block label for each frame. The label changes when the image has moved by ``BLOCK_PX``; a row of
    NaN does not change the label."""
    labels, label = np.zeros(len(attitude), np.intp), 0
    start: Array | None = None
    for k, q in enumerate(attitude):
        if np.isfinite(q).all():
            if start is not None:
                turn = turn_between(start[None], q[None])[0]
                # A roll moves the corners by the half diagonal.
                move = np.linalg.norm([turn[0], turn[1], turn[2] * camera.half_diagonal_rad]) / camera.pixel_rad
                if move >= BLOCK_PX:
                    start, label = q, label + 1
            else:
                start = q
        labels[k] = label
    return labels


def trials_of(condition: str, scores: Sequence[Score]) -> Trials:
    """Count the verdicts under one condition. An imprecise attitude is counted as correct, and its error is included in
    the errors."""
    good = [s for s in scores if s.verdict in (Verdict.CORRECT, Verdict.IMPRECISE)]
    false = sum(s.verdict is Verdict.WRONG for s in scores)
    return Trials(condition, len(scores), len(good), false, np.array([s.cross_rad for s in good], float))
