"""A stored frame with its solutions."""

from __future__ import annotations

from dataclasses import dataclass

from gss.store.models import Frame, Solution


@dataclass(frozen=True)
class FrameDetail:
    """A frame with its solutions, newest first. ``on_board``: latest result of the sensor. ``ground``: operational
    ground solution, with which the on-board result is compared. ``same_as``: id of the first earlier frame with the same
    pixels, None if there is none."""

    frame: Frame
    solutions: list[Solution]
    on_board: Solution | None
    ground: Solution | None
    same_as: int | None = None
