"""A chain's result as the row that the store keeps."""

from __future__ import annotations

from datetime import datetime
from typing import Any

import numpy as np

from gss import __version__
from gss.domain.frames import pointing_difference_rad
from gss.domain.profiles import PROFILES, CameraProfile
from gss.domain.results import SolveResult
from gss.domain.rotation import matrix_from_quaternion
from gss.domain.stars import StarTable
from gss.operations import overlay
from gss.operations.camera_record import record_of
from gss.operations.scoring import judge
from gss.store.models import Frame, Solution


def solution_values(
    result: SolveResult, stars: StarTable, profile_name: str | None, truth: list[Any] | None
) -> dict[str, Any]:
    """The columns of a solution as plain values. ``truth``: quaternion of a simulated frame, against which it is judged."""
    known = PROFILES.get(profile_name or "")
    values: dict[str, Any] = {
        "chain": result.chain,
        "version": __version__,
        "outcome": str(result.outcome),
        "reason": result.reason,
        "found": len(result.centroids),
        "matched": 0 if result.matches is None else len(result.matches),
        "rejected": sum(1 for r in result.regions if r.rejected),
        "rms_px": finite(result.residual_rms_px),
        "false_match_probability": finite(result.false_match_probability),
        "fov_rad": [float(v) for v in result.camera.fov_rad],
        "camera": record_of(result.camera),
        "timing_s": dict(result.timing_s),
        "notes": list(result.notes),
        "detail": overlay.describe(
            result.camera,
            stars,
            _faint_limit(known, result),
            result.regions,
            result.centroids,
            result.matches,
            result.attitude,
        ),
    }
    if result.attitude is not None:
        values["quaternion"] = [float(v) for v in result.attitude.quaternion]
        values["sigma_rad"] = [finite(v) for v in result.attitude.sigma_rad]
    if truth is not None and known is not None:
        values |= _judged(result, np.array(truth, float), known, stars)
    return values


def _judged(result: SolveResult, truth: Any, known: CameraProfile, stars: StarTable) -> dict[str, Any]:
    values: dict[str, Any] = {"verdict": str(judge(result, truth, known, stars))}
    if result.attitude is not None:
        off = pointing_difference_rad(result.attitude.cam_from_icrs, matrix_from_quaternion(truth))
        values["error_axis_rad"], values["error_roll_rad"] = off
    return values


def solution_row(frame: Frame, result: SolveResult, stars: StarTable, origin: str, created: datetime) -> Solution:
    """A new row for a frame."""
    values = solution_values(result, stars, frame.profile, frame.truth)
    return Solution(frame_id=frame.id, origin=origin, created=created, **values)


def finite(value: float) -> float | None:
    """The number, None where it is none: databases and JSON have no NaN."""
    return float(value) if np.isfinite(value) else None


def _faint_limit(known: CameraProfile | None, result: SolveResult) -> float:
    """Down to which magnitude predicted stars are shown: the camera's own limit, else what was matched."""
    if known is not None:
        return known.sensor.faint_limit_mag
    return 6.5 if result.camera.fov_rad[0] < 0.35 else 5.0
