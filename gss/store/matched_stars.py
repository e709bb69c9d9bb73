"""Stars that were matched in stored frames."""

from __future__ import annotations

import math

from sqlalchemy import select
from sqlalchemy.orm import Session

from gss.store.models import Frame, Solution
from gss.store.packed_detail import Rows


def newest_matches(session: Session, limit: int) -> list[tuple[Frame, dict[int, float | None]]]:
    """Return the newest frames with an operational ground attitude, newest first. For each frame: the Hipparcos numbers
    of the matched stars, with the distance between measured and predicted position in pixels, None if unknown."""
    query = (
        select(Frame, Solution.detail)
        .join(Solution, Solution.frame_id == Frame.id)
        .where(Solution.operational, Solution.outcome == "solved")
        .order_by(Frame.id.desc())
        .limit(limit)
    )
    return [(frame, _matches(detail.get("stars", []))) for frame, detail in session.execute(query)]


def _matches(stars: Rows) -> dict[int, float | None]:
    return {star["hip"]: _residual_px(star.get("dx_px"), star.get("dy_px")) for star in stars if "hip" in star}


def _residual_px(dx_px: float | None, dy_px: float | None) -> float | None:
    return None if dx_px is None or dy_px is None else math.hypot(dx_px, dy_px)
