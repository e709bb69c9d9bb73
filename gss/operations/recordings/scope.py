"""The content of a recording: its frames, the time span of telemetry and log, and its use."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime, timedelta

from gss.domain.errors import BadInput, NotFound
from gss.operations.clock import Now
from gss.operations.recordings.blueprints import Use
from gss.store import devices, frames, jobs, studies
from gss.store.engine import Database
from gss.store.models import Analysis, Calibration

MAX_FRAMES = 2000
MARGIN_S = 30.0
"""Telemetry and log are included for this time before and after the frames."""


@dataclass(frozen=True)
class Scope:
    """Content of one recording. ``name``: name of the recording and its file; ``frame_ids``: oldest frame first;
    ``start``, ``end``: time span of telemetry, commands and events. ``every``: only every n-th frame is contained."""

    name: str
    use: Use
    frame_ids: tuple[int, ...]
    start: datetime
    end: datetime
    every: int = 1


class Scopes:
    """Determines the content for a frame, a selection, a contact, a calibration, an analysis or a campaign."""

    def __init__(self, database: Database, now: Now) -> None:
        self._database, self._now = database, now

    def of_frames(self, ids: list[int]) -> Scope:
        """Return the scope of these frames. Raises NotFound if a frame does not exist."""
        if not ids:
            raise BadInput("no frames given", expected="numbers and ranges such as 3,5-9")
        name = f"gss-frame-{ids[0]}" if len(ids) == 1 else f"gss-frames-{min(ids)}-{max(ids)}"
        return self._around(name, Use.FRAME if len(ids) == 1 else Use.SEQUENCE, ids)

    def around(self, frame_id: int, each_side: int) -> Scope:
        """Return the scope of a frame with up to ``each_side`` frames before and after it."""
        with self._database.unit_of_work() as session:
            frames.get(session, frame_id)
            ids = frames.ids_around(session, frame_id, each_side)
        return self._around(f"gss-frame-{frame_id}", Use.FRAME, ids)

    def of_contact(self, contact_id: int) -> Scope:
        """Return the scope of a contact, from the opening to the closing of the line. A contact with more than
        ``MAX_FRAMES`` frames is thinned evenly and keeps its latest frame."""
        with self._database.unit_of_work() as session:
            contact, _ = devices.get_contact(session, contact_id)
            ids = frames.ids_of_contact(session, contact_id)
        end = contact.ended or self._now()
        every = max(1, -(-len(ids) // MAX_FRAMES))
        kept = tuple(reversed(ids[::-every]))
        return Scope(f"gss-contact-{contact_id}", Use.CONTACT, kept, contact.started, end, every)

    def of_calibration(self, calibration_id: int) -> Scope:
        """Return the scope of the frames from which a camera was calibrated."""
        with self._database.unit_of_work() as session:
            row = studies.calibration(session, calibration_id)
        return self._study(row, "calibration")

    def of_analysis(self, analysis_id: int) -> Scope:
        """Return the scope of the frames of an analysis."""
        with self._database.unit_of_work() as session:
            row = studies.analysis(session, analysis_id)
        return self._study(row, "analysis")

    def of_campaign(self, job_id: int) -> Scope:
        """Return the scope of the stored frames on which a campaign ran a chain."""
        with self._database.unit_of_work() as session:
            job = jobs.get(session, job_id)
            chain, end = job.request.get("chain"), job.finished or self._now()
            ids = [] if chain is None else frames.ids_solved(session, chain, job.created, end, MAX_FRAMES)
        return self._around(f"gss-campaign-{job_id}", Use.CAMPAIGN, ids, "this campaign used no stored frames")

    def _study(self, row: Calibration | Analysis, study: str) -> Scope:
        ids = sorted({int(i) for key in ("frame_ids", "dark_ids", "other_ids") for i in row.request.get(key) or ()})
        with self._database.unit_of_work() as session:
            existing_ids = frames.existing_ids(session, ids[:MAX_FRAMES])
        return self._around(f"gss-{study}-{row.id}", Use.CAMPAIGN, existing_ids, f"this {study} used no stored frames")

    def _around(self, name: str, use: Use, ids: list[int], empty: str = "no frames found") -> Scope:
        if not ids:
            raise NotFound(empty, hint="a recording needs stored frames")
        if len(ids) > MAX_FRAMES:
            raise BadInput("too many frames", expected=f"at most {MAX_FRAMES}", got=str(len(ids)))
        with self._database.unit_of_work() as session:
            times = [frames.get(session, i).taken for i in sorted(set(ids))]
        margin = timedelta(seconds=MARGIN_S)
        return Scope(name, use, tuple(sorted(set(ids))), min(times) - margin, max(times) + margin)
