"""Reasons of failed identifications that name their cause: their texts, and the cause of a stored reason."""

from __future__ import annotations

from enum import StrEnum

MIRRORED = "the frame is mirrored: its left-right mirror image matches the sky better. The optics or the file mirror it"
CUT_TRAILS = (
    "the stars are trails longer than 26 px, and only parts of them are detected. A shorter exposure or a slower rotation "
    "gives shorter trails"
)
OTHER_FOCAL_LENGTH = "it is not this focal length"


class FailureCause(StrEnum):
    """Cause that the solver has determined. ``SCALE``: the image has another scale than the assumed camera."""

    MIRRORED = "mirrored"
    SCALE = "scale"
    NOT_DETERMINED = ""


def cause_of(reason: str) -> FailureCause:
    """Return the cause that a reason names. Reasons are stored as text, also those of earlier versions."""
    if reason.startswith(MIRRORED.partition(":")[0]):
        return FailureCause.MIRRORED
    return FailureCause.SCALE if reason.endswith(OTHER_FOCAL_LENGTH) else FailureCause.NOT_DETERMINED
