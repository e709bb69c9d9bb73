"""Frame replay: the sensor's results compared with the ground's results on the same data, stage by stage."""

from __future__ import annotations

from typing import Literal

from gss.api.schemas.base import Out


class ReplayStageOut(Out):
    """One stage. ``difference``: difference as text, empty if none; ``difference_px`` on the detector,
    ``difference_arcsec`` on the sky, null if not applicable."""

    name: str
    verdict: Literal["equal", "differs", "not sent", "not compared"]
    on_board: str
    ground: str
    difference: str
    difference_px: float | None
    difference_arcsec: float | None


class FrameReplayOut(Out):
    """All stages in processing order. ``text``: "equal", or the first difference."""

    frame_id: int
    text: str
    stages: list[ReplayStageOut]
