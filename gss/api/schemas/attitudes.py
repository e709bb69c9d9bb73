"""Attitude messages and their comparison with stored frames."""

from __future__ import annotations

from gss.api.schemas.base import Out, Utc


class ComparedAttitudeOut(Out):
    """Frame with the rotation about the camera's axes that is left after the mean rotation."""

    frame_id: int
    at: Utc
    residual_arcsec: tuple[float, float, float]


class AttitudeComparisonOut(Out):
    """Stored attitudes against those of a message. ``cam_from_frame``: mean rotation from the message's frame to the camera, scalar
    last; ``angle_deg``: of that rotation; ``rms_arcsec``: of the residuals; ``outside``: frames for which the message has none."""

    object_name: str
    frame: str
    cam_from_frame: tuple[float, float, float, float]
    angle_deg: float
    rms_arcsec: tuple[float, float, float]
    frames: int
    outside: int
    compared: list[ComparedAttitudeOut]
