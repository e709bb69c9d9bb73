"""The search-and-track state machine (Moniteq 1983 §6.1, Fig. 6.1) as a function from state to state.

The machine is told what a frame gave and answers what to do next; it owns no clock: ages are counted in frames. The document leaves
open how old motion data may be (its constant X) and when the startup cycle ends; both are said here.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import StrEnum

VERIFIED_ENOUGH = 2


class Search(StrEnum):
    """How the next frame is searched: the predicted field by linear search or by links, a part of the sky, or all of it."""

    STARTUP = "startup"
    LINKS = "links"
    SUBSECTION = "subsection"
    FULL_SKY = "full_sky"


@dataclass(frozen=True)
class TrackerState:
    """``guidance_error`` may also be set from outside. ``startup``: no field is known yet. ``age``: frames
    since the last verified one."""

    guidance_error: bool = False
    startup: bool = True
    age: int = 0


def raises_guidance_error(verified: int, unaccounted: int) -> bool:
    """Step 2f: spots that nobody expected matter only where fewer than two stars were verified."""
    return unaccounted > 0 and verified < VERIFIED_ENOUGH


def search_of(state: TrackerState, oldest: int) -> Search:
    """What the next frame is searched with; motion data older than ``oldest`` frames say nothing (the document's X)."""
    if state.guidance_error:
        return Search.SUBSECTION if state.age <= oldest else Search.FULL_SKY
    return Search.STARTUP if state.startup else Search.LINKS


def after_frame(state: TrackerState, verified: int, unaccounted: int, blind_found: int | None = None) -> TrackerState:
    """The state after a frame. ``blind_found``: stars of a connected pattern that a blind search named on the same frame, None
    if there was none. A successful one clears the flag; a failed one keeps it, because the data behind a prediction are stale
    (the document clears it and would go on with them)."""
    if blind_found is not None and blind_found >= VERIFIED_ENOUGH:
        return TrackerState(False, False, 0)
    if blind_found is None and not raises_guidance_error(verified, unaccounted):
        return TrackerState(False, state.startup and verified == 0, 0 if verified else state.age + 1)
    return replace(state, guidance_error=True, age=state.age + 1)
