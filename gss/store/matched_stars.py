"""Stars that were matched in stored frames."""

from __future__ import annotations

from sqlalchemy import JSON, select, type_coerce
from sqlalchemy.orm import Session

from gss.store.models import Frame, Solution
from gss.store.packed_detail import residuals_px


def newest_matches(session: Session, limit: int) -> list[tuple[Frame, dict[int, float | None]]]:
    """Return the newest frames with an operational ground attitude, newest first. For each frame: the Hipparcos numbers
    of the matched stars, with the distance between measured and predicted position in pixels, None if unknown."""
    query = (
        select(Frame, type_coerce(Solution.detail, JSON))
        .join(Solution, Solution.frame_id == Frame.id)
        .where(Solution.operational, Solution.outcome == "solved")
        .order_by(Frame.id.desc())
        .limit(limit)
    )
    return [(frame, residuals_px(detail)) for frame, detail in session.execute(query)]
