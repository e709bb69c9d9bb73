"""Conversion of a chain's result to the stored row."""

from __future__ import annotations

from datetime import datetime
from typing import TYPE_CHECKING, Any, NotRequired, Required, TypedDict

import numpy as np

from gss import __version__
from gss.domain.camera import Camera
from gss.domain.camera_profile import CameraProfile
from gss.domain.camera_record import camera_from, record_of
from gss.domain.frames import pointing_difference_rad
from gss.domain.json_object import JsonObject
from gss.domain.results import Centroids, SolveResult
from gss.domain.rotation import matrix_from_quaternion
from gss.domain.stars import StarTable
from gss.operations.frames import overlay
from gss.operations.frames.planets import with_planets
from gss.operations.frames.scoring import judge
from gss.store.packed_detail import RegionColumns, StarColumns, with_rows

if TYPE_CHECKING:
    from gss.store.models import Frame, Solution


class TurningValues(TypedDict):
    """Angular rate from the trails of a frame, in the camera frame."""

    rad_s: list[float]
    covariance_rad2_s2: list[list[float | None]]
    stars: int
    sign_known: bool


class SolutionDetail(TypedDict):
    """Regions and stars, the rate from trails, the observer's velocity, and software versions."""

    regions: RegionColumns
    stars: StarColumns
    versions: dict[str, str]
    velocity_c: NotRequired[list[float]]
    turning: NotRequired[TurningValues]


class SolutionValues(TypedDict, total=False):
    """Columns of a solution. If a chain could not be run on a frame, only the required columns are set. ``detail``: plain, or
    packed for the database."""

    chain: Required[str]
    version: Required[str]
    outcome: Required[str]
    reason: Required[str]
    found: int
    matched: int
    rejected: int
    rms_px: float | None
    false_match_probability: float | None
    fov_rad: list[float]
    camera: JsonObject
    timing_s: dict[str, float]
    notes: list[str]
    options: str
    detail: SolutionDetail | JsonObject
    quaternion: list[float]
    sigma_rad: list[float | None]
    verdict: str
    error_axis_rad: float
    error_roll_rad: float


def solution_values(
    result: SolveResult,
    stars: StarTable,
    profile: CameraProfile | None,
    truth: list[Any] | None,
) -> SolutionValues:
    """Return the columns of a solution as plain values, except that ``detail`` has columns of regions and stars.
    ``profile``: documented camera, None if unknown. ``truth``: true quaternion of a simulated frame, with which the result is
    compared. :func:`with_overlays` computes the overlays that are derived from the attitude."""
    values: SolutionValues = {
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
        "options": result.options,
        "detail": _detail(result, stars),
    }
    if result.attitude is not None:
        values["quaternion"] = [float(v) for v in result.attitude.quaternion]
        values["sigma_rad"] = [finite(v) for v in result.attitude.sigma_rad]
    if truth is not None and profile is not None:
        attitude = np.array(truth, float)
        values["verdict"] = str(judge(result, attitude, profile, stars))
        if result.attitude is not None:
            errors_rad = pointing_difference_rad(result.attitude.cam_from_icrs, matrix_from_quaternion(attitude))
            values["error_axis_rad"], values["error_roll_rad"] = errors_rad
    return values


def _detail(result: SolveResult, stars: StarTable) -> SolutionDetail:
    detail: SolutionDetail = {
        "regions": overlay.regions_of(result.regions),
        "stars": overlay.stars_of(result.camera, stars, result.centroids, result.matches),
        "versions": dict(result.versions),
    }
    if result.velocity_c is not None:
        detail["velocity_c"] = list(result.velocity_c)
    if result.turning is not None:
        detail["turning"] = {
            "rad_s": [float(v) for v in result.turning.vector_rad_s],
            "covariance_rad2_s2": [[finite(v) for v in row] for row in result.turning.covariance_rad2_s2],
            "stars": result.turning.stars,
            "sign_known": result.turning.sign_known,
        }
    return detail


def solution_row(
    frame: Frame,
    profile: CameraProfile | None,
    result: SolveResult,
    stars: StarTable,
    origin: str,
    created: datetime,
    camera_name: str,
) -> Solution:
    """Return a new row for the result of a frame. ``profile``: documented camera of the frame, None if unknown."""
    from gss.store.models import Solution

    values = solution_values(result, stars, profile, frame.truth)
    values["detail"] = with_rows(values["detail"])
    return Solution(frame_id=frame.id, origin=origin, created=created, camera_name=camera_name, **values)


def with_overlays(row: Solution, stars: StarTable, profile: CameraProfile | None, taken: datetime | None) -> JsonObject:
    """Return the overlays of a stored solution. Overlays derived from its attitude and camera are computed. Rows of older versions
    contain them. ``taken``: time of exposure, with which unmatched stars that are planets get their name; None if unknown."""
    if "grid" in row.detail:
        return row.detail
    if row.quaternion is None or not row.camera:
        return {"regions": [], "stars": []} | overlay.NOTHING | row.detail
    camera = camera_from(row.camera)
    cam_from_icrs = matrix_from_quaternion(np.array(row.quaternion, float))
    spots = row.detail["stars"]
    col_px, row_px = (np.array([s[name] for s in spots], float) for name in ("col_px", "row_px"))
    zeros = np.zeros(len(spots))
    centroids = Centroids(col_px, row_px, zeros, zeros, zeros.astype(np.int32), zeros)
    limit = _limit_of(profile, camera)
    velocity_c = row.detail.get("velocity_c")  # a list in the store
    velocity = None if velocity_c is None else (velocity_c[0], velocity_c[1], velocity_c[2])
    shown = overlay.describe(camera, stars, limit, centroids, cam_from_icrs, velocity) | row.detail
    if taken is not None:
        shown["stars"] = with_planets(spots, camera, cam_from_icrs, velocity, taken)
    return shown


def finite(value: float) -> float | None:
    """Return the number, None for NaN and infinity, which databases and JSON cannot represent."""
    return float(value) if np.isfinite(value) else None


def _limit_of(profile: CameraProfile | None, camera: Camera) -> float:
    """Return the magnitude limit for predicted stars: the limit of the documented camera, otherwise an estimate from the field of
    view."""
    if profile is not None:
        return profile.sensor.faint_limit_mag
    return 6.5 if camera.fov_rad[0] < 0.35 else 5.0
