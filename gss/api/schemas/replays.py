"""A frame replayed: what the sensor said beside what the ground makes of the same, stage by stage."""

from __future__ import annotations

from typing import Literal

from gss.api.schemas.base import Out


class ReplayStageOut(Out):
    """One stage. ``difference``: in words, empty where there is none; ``difference_px`` on the detector, ``difference_arcsec`` on
    the sky, null where that has no meaning."""

    name: str
    verdict: Literal["equal", "differs", "not sent", "not compared"]
    on_board: str
    ground: str
    difference: str
    difference_px: float | None
    difference_arcsec: float | None


class FrameReplayOut(Out):
    """All stages in the order of the work. ``text``: "equal", or the first difference."""

    frame_id: int
    text: str
    stages: list[ReplayStageOut]
