"""Uploaded lists of measured stars."""

from __future__ import annotations

from gss.api.schemas.base import Out, Utc
from gss.api.schemas.jobs import JobOut


class ListRunOut(Out):
    """Uploaded file of star lists. ``solved``: number of solved lists, null until the job has ended."""

    id: int
    name: str
    created: Utc
    author: str
    tool: str
    camera: str
    no_distortion: bool
    sigma_px: float
    epoch_jyear: float
    lists: int
    size: int
    solved: int | None


class ListRunStartedOut(Out):
    """Stored file and the job that solves its lists."""

    run: ListRunOut
    job: JobOut


class ListResultOut(Out):
    """Result of one list. ``list``: number of the list in the file; ``quaternion``: cam_from_icrs, scalar last; ``ms``:
    processor time."""

    list: int
    outcome: str
    reason: str
    ra_deg: float | None
    dec_deg: float | None
    roll_deg: float | None
    quaternion: tuple[float, float, float, float] | None
    matched: int
    false_match_probability: float | None
    ms: float
    notes: tuple[str, ...]


class ListResultsOut(Out):
    """Page of the results of a run, in the order of the file."""

    total: int
    results: list[ListResultOut]
