"""Solutions of frames."""

from __future__ import annotations

from gss.api import present
from gss.api.api_router import api_router
from gss.api.deps import App, RowId
from gss.api.schemas.frames import SolutionDetailOut

router = api_router("solutions")


@router.get("/solutions/{solution_id}")
def read_solution(app: App, solution_id: RowId) -> SolutionDetailOut:
    """Solution with its overlays."""
    return present.frames.solution_detail(app.frames.frames.solution(solution_id))
