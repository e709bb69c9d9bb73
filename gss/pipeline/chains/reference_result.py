"""Results of the reference chain."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from gss.domain.angles import Array
from gss.domain.camera import Camera
from gss.domain.results import Attitude, Centroids, Matches, Outcome, SolveResult, Turning
from gss.domain.rotation import quaternion_from_matrix
from gss.pipeline.detect import Detections
from gss.pipeline.refine import Refined
from gss.pipeline.trace import Trace


def unsolved(
    chain: str,
    camera: Camera,
    centroids: Centroids,
    detections: Detections | None,
    notes: tuple[str, ...],
    turning: Turning | None = None,
) -> SolveResult:
    """Return a result without a solution. The caller adds a reason or a solution."""
    regions = detections.regions if detections else ()
    versions = {"detect": detections.loops} if detections else {}
    return SolveResult(
        chain,
        Outcome.NONE,
        "",
        camera,
        regions,
        centroids,
        matches=None,
        attitude=None,
        false_match_probability=float("nan"),
        notes=notes,
        turning=turning,
        versions=versions,
    )


def solved(
    base: SolveResult,
    fit: Refined,
    rows: NDArray[np.intp],
    hip: NDArray[np.int32],
    false_match_probability: float,
    trace: Trace,
    velocity_c: Array | None,
) -> SolveResult:
    """Return ``base`` with its solution: the fit, and the matched (m,) rows of the centroids and (m,) stars.

    ``trace``: durations of the stages. ``velocity_c``: (3,) ICRS velocity of the observer in units of c, which the fit
    took into account; None without aberration.
    """
    return replace(
        base,
        outcome=Outcome.SOLVED,
        camera=fit.camera,
        matches=Matches(rows.astype(np.int32), hip.astype(np.int32), fit.weight, fit.residual_px),
        attitude=Attitude(quaternion_from_matrix(fit.cam_from_icrs), fit.covariance_rad2),
        false_match_probability=false_match_probability,
        velocity_c=_as_velocity(velocity_c),
        timing_s=dict(trace.timing_s),
    )


def _as_velocity(velocity_c: Array | None) -> tuple[float, float, float] | None:
    """Return a velocity as plain numbers, for the result."""
    if velocity_c is None:
        return None
    x, y, z = (float(v) for v in velocity_c)
    return x, y, z
