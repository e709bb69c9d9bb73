"""Uploads and downloads."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from gss.api.schemas.base import In, Out, Utc

MAX_PX = 65535


class RegionIn(In):
    """Rectangle of the detector."""

    col_px: int = Field(ge=0, le=MAX_PX)
    row_px: int = Field(ge=0, le=MAX_PX)
    columns: int = Field(ge=1, le=MAX_PX)
    rows: int = Field(ge=1, le=MAX_PX)


class FrameRegionOut(Out):
    """Rectangle of the detector."""

    col_px: int
    row_px: int
    columns: int
    rows: int


class TransferOptionsOut(Out):
    """Options of a transfer other than kind and target."""

    region: FrameRegionOut | None = None
    side_px: int | None = None
    solve: bool | None = None


class TransferOut(Out):
    """Transfer. ``stored``: ranges of chunks (first, last) that the receiver reports as stored. ``slot``: number of the
    image memory slot or bank on the wire. ``can_…``: true if the action is possible now."""

    id: int
    direction: Literal["up", "down"]
    kind: str
    target: str
    slot: int | None
    subject: str
    state: str
    reason: str
    size: int
    chunk_size: int
    chunks: int
    stored: list[tuple[int, int]]
    stored_bytes: int
    resent: int
    rate_bytes_s: float | None
    line_share: float | None
    left_s: float | None
    sha256: str
    created: Utc
    finished: Utc | None
    frame_id: int | None
    catalogue_id: int | None
    table_id: int | None
    options: TransferOptionsOut
    can_pause: bool
    can_resume: bool
    can_abort: bool
    log: list[str]


class TransferIn(In):
    """Download request. Image kinds need ``slot``, the others ``bank``; kind region needs ``region``, kind star_windows
    ``side_px``."""

    kind: Literal[
        "frame",
        "thumbnail",
        "region",
        "star_windows",
        "catalogue",
        "star_list",
        "distance_table",
        "triplets",
        "calibration",
        "parameters",
        "bad_pixels",
    ]
    slot: int | None = Field(default=None, ge=0, le=255)
    bank: str | None = Field(default=None, max_length=20)
    region: RegionIn | None = None
    side_px: int | None = Field(default=None, ge=5, le=31)


class FrameUploadIn(In):
    """Image memory slot to upload a stored frame to. ``solve``: true to solve it on board."""

    slot: int = Field(ge=0, le=255)
    solve: bool = True
