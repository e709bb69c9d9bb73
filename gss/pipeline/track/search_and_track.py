"""Search-and-track state machine (Moniteq 1983 §6.1, Fig. 6.1) as a pure function from state to state.

The caller passes the result of a frame and gets the next state. There is no clock: ages are counted in frames. The document
does not define how old motion data may be (its constant X) or when the startup cycle ends; both are defined here.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import StrEnum

VERIFIED_ENOUGH = 2


class Search(StrEnum):
    """Search method for the next frame: the predicted field by linear search or by links, part of the sky, or all of it."""

    STARTUP = "startup"
    LINKS = "links"
    SUBSECTION = "subsection"
    FULL_SKY = "full_sky"


@dataclass(frozen=True)
class TrackerState:
    """``guidance_error`` may also be set by the caller. ``startup``: True while no field is known. ``age``: number of frames
    since the last verified one."""

    guidance_error: bool = False
    startup: bool = True
    age: int = 0


def raises_guidance_error(verified: int, unaccounted: int) -> bool:
    """True if there are unexpected spots and fewer than two verified stars (step 2f)."""
    return unaccounted > 0 and verified < VERIFIED_ENOUGH


def search_of(state: TrackerState, oldest: int) -> Search:
    """Return the search method for the next frame; motion data older than ``oldest`` frames (the document's X) are not used."""
    if state.guidance_error:
        return Search.SUBSECTION if state.age <= oldest else Search.FULL_SKY
    return Search.STARTUP if state.startup else Search.LINKS


def after_frame(state: TrackerState, verified: int, unaccounted: int, blind_found: int | None = None) -> TrackerState:
    """Return the state after a frame.

    ``blind_found``: number of stars of a connected pattern that a blind search identified on the same frame, None if no blind
    search was made. A successful blind search clears ``guidance_error``; a failed one keeps it, because the data for a prediction
    are stale (the document clears it and continues with them).
    """
    if blind_found is not None and blind_found >= VERIFIED_ENOUGH:
        return TrackerState(False, False, 0)
    if blind_found is None and not raises_guidance_error(verified, unaccounted):
        return TrackerState(False, state.startup and verified == 0, 0 if verified else state.age + 1)
    return replace(state, guidance_error=True, age=state.age + 1)
