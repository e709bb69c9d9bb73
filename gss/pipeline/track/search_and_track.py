"""Guidance error of the search-and-track loop (Moniteq 1983 §6.1, Fig. 6.1).

The loop itself is the chain's modes: tracking verifies the stars expected in the field along the links, a guidance error leads to
the blind search of the same frame, and after a frame without an attitude the next one is searched for in part of the sky, then in
all of it.
"""

from __future__ import annotations

VERIFIED_ENOUGH = 2


def raises_guidance_error(verified: int, unaccounted: int) -> bool:
    """True if there are unexpected spots and fewer than two verified stars (step 2f)."""
    return unaccounted > 0 and verified < VERIFIED_ENOUGH
