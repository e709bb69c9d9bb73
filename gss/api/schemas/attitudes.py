"""Attitude messages and their comparison with stored frames."""

from __future__ import annotations

from gss.api.schemas.base import Out, Utc


class ComparedAttitudeOut(Out):
    """Frame with its residual rotation about the camera's axes after the mean rotation is removed."""

    frame_id: int
    at: Utc
    residual_arcsec: tuple[float, float, float]


class AttitudeComparisonOut(Out):
    """Comparison of stored attitudes with the attitudes of a message. ``cam_from_frame``: mean rotation from the
    message's frame to the camera, scalar-last quaternion; ``angle_deg``: angle of this rotation; ``rms_arcsec``: RMS
    residuals; ``outside``: number of frames for which the message has no attitude."""

    object_name: str
    frame: str
    cam_from_frame: tuple[float, float, float, float]
    angle_deg: float
    rms_arcsec: tuple[float, float, float]
    frames: int
    outside: int
    compared: list[ComparedAttitudeOut]
