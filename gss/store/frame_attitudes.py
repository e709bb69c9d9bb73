"""Attitudes of the frames of a time range."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime

from sqlalchemy import func, or_, select
from sqlalchemy.orm import Session

from gss.store.models import Frame, Solution


@dataclass(frozen=True)
class FrameAttitude:
    """Attitude of a frame. ``id``: id of the frame; ``quaternion``: cam_from_icrs, scalar-last; ``sigma_rad``: across
    and about the boresight, None if the chain does not state them."""

    id: int
    at: datetime
    quaternion: list[float]
    sigma_rad: list[float] | None


def attitudes_between(
    session: Session, instrument: str, origin: str, start: datetime, end: datetime, limit: int
) -> list[FrameAttitude]:
    """Return up to ``limit`` attitudes of frames exposed in a time range, oldest first: of the frames from the unit and of the
    imported ones of its ``instrument``, without frames whose time of exposure is unknown. For the origin ``ground``, use the
    operational attitude of each frame; for another origin, use the newest attitude of this origin."""
    newest_id = (
        select(func.max(Solution.id))
        .where(Solution.frame_id == Frame.id, Solution.origin == origin, Solution.outcome == "solved")
        .correlate(Frame)
        .scalar_subquery()
    )
    query = (
        select(Frame.id, Frame.taken, Solution.quaternion, Solution.sigma_rad)
        .join(Solution, Solution.frame_id == Frame.id)
        .where(Frame.taken.between(start, end), Frame.time_known)
        .where(or_(Frame.source == "device", Frame.profile == instrument))
        .where(Solution.outcome == "solved", Solution.quaternion.is_not(None))
        .where(Solution.operational if origin == "ground" else Solution.id == newest_id)
        .order_by(Frame.taken, Frame.id)
        .limit(limit)
    )
    return [FrameAttitude(*row) for row in session.execute(query)]
