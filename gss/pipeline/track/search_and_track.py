"""Guidance error of the search-and-track loop (Moniteq 1983 §6.1, Fig. 6.1).

The modes of the chain implement the loop. Tracking verifies the stars expected in the field along the links. A guidance
error starts a blind search with the same frame. After a frame without an attitude, the next frame is matched with a
part of the sky. If this fails too, the frame after it is matched with the whole sky.
"""

from __future__ import annotations

VERIFIED_ENOUGH = 2


def raises_guidance_error(verified: int, unaccounted: int) -> bool:
    """True if there are unexpected spots and fewer than two verified stars (step 2f)."""
    return unaccounted > 0 and verified < VERIFIED_ENOUGH
