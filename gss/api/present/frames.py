"""Frames, solutions and their comparison as responses."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from gss.api.schemas.frames import (
    AttitudeOut,
    CameraOut,
    ComparisonOut,
    DifferenceOut,
    FrameDetailOut,
    FrameOut,
    SolutionDetailOut,
    SolutionOut,
    StarOut,
    TurningOut,
)
from gss.api.schemas.replays import FrameReplayOut, ReplayStageOut
from gss.domain.angles import wrap_pi_rad
from gss.domain.failure_cause import cause_of
from gss.domain.frames import attitudes_agree, pointing_difference_rad, ra_dec_roll_rad
from gss.domain.rotation import matrix_from_quaternion
from gss.operations.frames.frame_detail import FrameDetail
from gss.operations.frames.replay_stages import ReplayStage, first_difference
from gss.operations.frames.solution_rows import TurningValues
from gss.store.models import Frame, Solution


def arcsec(angle_rad: float) -> float:
    """Convert radians to arcseconds."""
    return math.degrees(angle_rad) * 3600


def attitude(quaternion: Sequence[float] | None, sigma_rad: Sequence[float | None] | None) -> AttitudeOut | None:
    """Return an attitude in degrees, as a quaternion, with sigmas in arcseconds. ``quaternion``: cam_from_icrs,
    scalar-last; ``sigma_rad``: sigmas across and about the boresight."""
    if quaternion is None:
        return None
    ra, dec, roll = ra_dec_roll_rad(matrix_from_quaternion(np.array(quaternion, float)))
    cross, about = sigma_rad or (None, None)
    x, y, z, w = (float(q) for q in quaternion)
    return AttitudeOut(
        ra_deg=math.degrees(ra),
        dec_deg=math.degrees(dec),
        roll_deg=math.degrees(roll),
        quaternion=(x, y, z, w),
        sigma_cross_arcsec=None if cross is None else arcsec(cross),
        sigma_roll_arcsec=None if about is None else arcsec(about),
    )


def frame(row: Frame, best: Solution | None) -> FrameOut:
    """Return a frame with a summary of its operational ground solution."""
    names = (
        "id number slot source name taken time_known received columns rows bits "
        "exposure_s profile mode sha256 complete rows_held contact_id pixels_removed favourite"
    )
    return FrameOut(
        **{name: getattr(row, name) for name in names.split()},
        part=row.parameters.get("part", ""),
        held=row.parameters.get("held", []),
        verdict=best.verdict if best else None,
        outcome=best.outcome if best else None,
        chain=best.chain if best else None,
        camera_name=best.camera_name if best else None,
        matched=best.matched if best else None,
        centroids=best.found if best else None,
        attitude=attitude(best.quaternion, best.sigma_rad) if best else None,
    )


def frame_detail(detail: FrameDetail) -> FrameDetailOut:
    """Return a frame with all its solutions and their comparison."""
    return FrameDetailOut(
        **dict(frame(detail.frame, detail.ground)),
        solutions=[solution(s) for s in detail.solutions],
        on_board=solution_detail(detail.on_board) if detail.on_board else None,
        ground=solution_detail(detail.ground) if detail.ground else None,
        comparison=comparison(detail.on_board, detail.ground),
        truth=attitude(detail.frame.truth, None),
        instrument_version=detail.frame.instrument_version,
        same_as=detail.same_as,
    )


def solution(row: Solution) -> SolutionOut:
    """Return a solution without its overlays."""
    names = (
        "id frame_id origin chain version created outcome reason found matched rejected rms_px "
        "false_match_probability verdict replay notes camera_name operational options"
    )
    fov_deg = (math.degrees(row.fov_rad[0]), math.degrees(row.fov_rad[1])) if row.fov_rad else None
    used_stars = [s for s in row.detail.get("stars", ()) if s.get("dx_arcsec") is not None and s["weight"] > 0]
    weights = sum(s["weight"] for s in used_stars)
    square = sum(s["weight"] * (s["dx_arcsec"] ** 2 + s["dy_arcsec"] ** 2) / 2 for s in used_stars)
    return SolutionOut(
        **{name: getattr(row, name) for name in names.split()},
        attitude=attitude(row.quaternion, row.sigma_rad),
        rms_arcsec=math.sqrt(square / weights) if weights else None,
        fov_deg=fov_deg,
        timing_ms={name: 1000 * s for name, s in row.timing_s.items()},
        error_axis_arcsec=None if row.error_axis_rad is None else arcsec(row.error_axis_rad),
        error_roll_arcsec=None if row.error_roll_rad is None else arcsec(row.error_roll_rad),
    )


def solution_detail(row: Solution) -> SolutionDetailOut:
    """Return a solution with its overlays."""
    detail = row.detail
    optional = ("hip", "name", "v_mag", "dx_px", "dy_px", "dx_arcsec", "dy_arcsec", "weight")
    return SolutionDetailOut(
        **dict(solution(row)),
        cause=cause_of(row.reason),
        turning=_turning(detail.get("turning")),
        aberration_arcsec=arcsec(math.hypot(*detail["velocity_c"])) if detail.get("velocity_c") else None,
        versions=detail.get("versions", {}),
        regions=detail["regions"],
        stars=[StarOut(**(dict.fromkeys(optional) | s)) for s in detail["stars"]],
        predicted=detail["predicted"],
        camera=CameraOut(**row.camera),
        grid=detail["grid"],
        north=detail["north"],
        field=[(math.degrees(a), math.degrees(d)) for a, d in detail["field"]],
    )


def _turning(record: TurningValues | None) -> TurningOut | None:
    if record is None:
        return None
    x, y, z = (math.degrees(v) for v in record["rad_s"])
    variances = [record["covariance_rad2_s2"][k][k] for k in range(3)]
    a, b, c = (None if v is None else math.degrees(math.sqrt(v)) for v in variances)
    return TurningOut(
        deg_s=(x, y, z),
        sigma_deg_s=(a, b, c),
        speed_deg_s=math.hypot(x, y, z),
        stars=record["stars"],
        sign_known=record["sign_known"],
    )


def frame_replay(frame_id: int, stages: list[ReplayStage]) -> FrameReplayOut:
    """Return the stages of a frame replay."""
    rows = [ReplayStageOut(**(vars(s) | {"verdict": str(s.verdict)})) for s in stages]
    return FrameReplayOut(frame_id=frame_id, text=first_difference(stages), stages=rows)


def difference(row: Frame, on_board: Solution, ground: Solution) -> DifferenceOut:
    """Return the difference of two attitudes of a frame."""
    compared = comparison(on_board, ground)
    if compared is None:
        raise ValueError(f"frame {row.id} does not have two attitudes")
    return DifferenceOut(frame_id=row.id, taken=row.taken, **compared.model_dump())


def comparison(on_board: Solution | None, ground: Solution | None) -> ComparisonOut | None:
    """Return on-board minus ground attitude; None if either is missing."""
    if on_board is None or ground is None or on_board.quaternion is None or ground.quaternion is None:
        return None
    a, b = (matrix_from_quaternion(np.array(s.quaternion, float)) for s in (on_board, ground))
    (ra_a, dec_a, roll_a), (ra_b, dec_b, roll_b) = ra_dec_roll_rad(a), ra_dec_roll_rad(b)
    cross_rad, about_rad = pointing_difference_rad(a, b)
    cross, about, agree = arcsec(cross_rad), arcsec(about_rad), attitudes_agree(cross_rad, about_rad)
    return ComparisonOut(
        d_ra_arcsec=arcsec(float(wrap_pi_rad(ra_a - ra_b))),
        d_dec_arcsec=arcsec(dec_a - dec_b),
        d_roll_arcsec=arcsec(float(wrap_pi_rad(roll_a - roll_b))),
        cross_arcsec=cross,
        agree=agree,
        text="on board and ground agree"
        if agree
        else f"on board and ground differ by {cross:.0f}″ across, {about:.0f}″ about",
    )
