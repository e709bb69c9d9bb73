"""Transfers in both directions."""

from __future__ import annotations

from typing import Literal

from gss.api.schemas.base import Out, Utc


class TransferOut(Out):
    """One transfer. ``stored``: ranges of chunks that the receiving side says it stored, first and last inclusive."""

    id: int
    direction: Literal["up", "down"]
    kind: str
    target: str
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
    log: list[str]
