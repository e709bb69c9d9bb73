"""What a recording holds: which frames, which span of telemetry and log, and for which use."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime, timedelta
from typing import Any

from sqlalchemy import select

from gss.domain.errors import BadInput, NotFound
from gss.operations.clock import Now
from gss.operations.recordings.blueprints import Use
from gss.store import devices, frames
from gss.store.engine import Database
from gss.store.models import Analysis, Calibration, Frame, Job, Solution

MOST_FRAMES = 2000
MARGIN_S = 30.0
"""Telemetry and log this long before and after the frames are kept with them."""


@dataclass(frozen=True)
class Scope:
    """``name`` becomes the recording's and the file's; frames oldest first; the span of telemetry, commands and events."""

    name: str
    use: Use
    frame_ids: tuple[int, ...]
    start: datetime
    end: datetime


class Scopes:
    """Finds what belongs to a frame, a selection, a contact, a calibration, an analysis or a campaign."""

    def __init__(self, database: Database, now: Now) -> None:
        self._database, self._now = database, now

    def of_frames(self, ids: list[int]) -> Scope:
        """These frames. NotFound for one that is not there."""
        if not ids:
            raise BadInput("no frames were given", expected="numbers and ranges such as 3,5-9")
        name = f"gss-frame-{ids[0]}" if len(ids) == 1 else f"gss-frames-{min(ids)}-{max(ids)}"
        return self._around(name, Use.FRAME if len(ids) == 1 else Use.SEQUENCE, ids)

    def around(self, frame_id: int, each_side: int) -> Scope:
        """A frame with those before and after it."""
        with self._database.unit_of_work() as session:
            frames.get(session, frame_id)
            before = select(Frame.id).where(Frame.id <= frame_id).order_by(Frame.id.desc()).limit(each_side + 1)
            after = select(Frame.id).where(Frame.id > frame_id).order_by(Frame.id).limit(each_side)
            ids = [*session.scalars(before), *session.scalars(after)]
        return self._around(f"gss-frame-{frame_id}", Use.FRAME, ids)

    def of_contact(self, contact_id: int) -> Scope:
        """Everything between opening the line and closing it."""
        with self._database.unit_of_work() as session:
            contact, _ = devices.get_contact(session, contact_id)
            newest = select(Frame.id).where(Frame.contact_id == contact_id).order_by(Frame.id.desc()).limit(MOST_FRAMES)
            ids = sorted(session.scalars(newest))
        end = contact.ended or self._now()
        return Scope(f"gss-contact-{contact_id}", Use.CONTACT, tuple(ids), contact.started, end)

    def of_calibration(self, calibration_id: int) -> Scope:
        """The frames that a camera was calibrated from."""
        return self._study(Calibration, "calibration", calibration_id)

    def of_analysis(self, analysis_id: int) -> Scope:
        """The frames of an analysis."""
        return self._study(Analysis, "analysis", analysis_id)

    def of_campaign(self, job_id: int) -> Scope:
        """The stored frames that a campaign ran a chain on."""
        with self._database.unit_of_work() as session:
            job = session.get(Job, job_id)
            if job is None:
                raise NotFound("no such campaign", got=str(job_id), hint="the number of its job")
            chain, end = job.request.get("chain"), job.finished or self._now()
            solved = select(Solution.frame_id).where(Solution.created >= job.created, Solution.created <= end)
            solved = solved.where(Solution.origin == "ground", Solution.chain == chain).distinct()
            ids = [] if chain is None else sorted(session.scalars(solved.limit(MOST_FRAMES)))
        return self._around(f"gss-campaign-{job_id}", Use.CAMPAIGN, ids, "this campaign ran on no stored frames")

    def _study(self, kind: type[Calibration] | type[Analysis], word: str, row_id: int) -> Scope:
        with self._database.unit_of_work() as session:
            row: Any = session.get(kind, row_id)
            if row is None:
                raise NotFound(f"no such {word}", got=str(row_id))
            ids = sorted({int(i) for key in ("frame_ids", "dark_ids", "other_ids") for i in row.request.get(key) or ()})
            there = sorted(session.scalars(select(Frame.id).where(Frame.id.in_(ids[:MOST_FRAMES]))))
        return self._around(f"gss-{word}-{row_id}", Use.CAMPAIGN, there, f"this {word} was made from no stored frames")

    def _around(self, name: str, use: Use, ids: list[int], empty: str = "no frames were found") -> Scope:
        if not ids:
            raise NotFound(empty, hint="a recording shows stored frames")
        if len(ids) > MOST_FRAMES:
            raise BadInput("too many frames", expected=f"at most {MOST_FRAMES}", got=str(len(ids)))
        with self._database.unit_of_work() as session:
            taken = [frames.get(session, i).taken for i in sorted(set(ids))]
        margin = timedelta(seconds=MARGIN_S)
        return Scope(name, use, tuple(sorted(set(ids))), min(taken) - margin, max(taken) + margin)
