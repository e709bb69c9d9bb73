"""Facts of one star: its row in the Hipparcos catalogue, the stored catalogues that contain it, and the frames in which
it was matched."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gss.catalogue_tools.envelope.orbits import jyear_of
from gss.catalogue_tools.sources.hipparcos import load_hipparcos, other_names, propagate
from gss.domain.angles import ra_dec_from_unit
from gss.domain.errors import NotFound
from gss.domain.stars import FLAG_MULTIPLE, FLAG_NO_PROPER_MOTION, FLAG_POOR_POSITION, FLAG_VARIABLE
from gss.operations.clock import Now
from gss.store import catalogues
from gss.store.engine import Database
from gss.store.matched_stars import newest_matches
from gss.store.models import Catalogue, Frame

MAX_CATALOGUES, MAX_FRAMES = 100, 200
EPOCH_WITHOUT_MOTION_JYEAR = 2000.0
"""Epoch of the positions of stars without proper motion, see docs/star-table.md."""
FLAG_WORDS = {
    FLAG_VARIABLE: "variable",
    FLAG_MULTIPLE: "double or multiple",
    FLAG_NO_PROPER_MOTION: "proper motion unknown",
    FLAG_POOR_POSITION: "position of low accuracy",
}


@dataclass(frozen=True)
class MatchedFrame:
    """Frame whose operational ground result contains the star. ``residual_px``: distance between the measured and the
    predicted position, None if it is not stored."""

    frame: Frame
    residual_px: float | None


@dataclass(frozen=True)
class StarCard:
    """Facts of a star. Right ascension and declination are ICRS at ``epoch_jyear``; proper motion in rad/yr. ``b_v``,
    proper motion and parallax are None if unknown. ``catalogues``: catalogues that contain the star, newest first;
    ``frames``: frames in which it was matched, newest first. ``checked_catalogues`` and ``checked_frames``: number of the
    newest catalogues and solved frames that were searched; ``unnumbered``: searched catalogues without star numbers."""

    hip: int
    name: str
    other_names: list[str]
    ra_rad: float
    dec_rad: float
    epoch_jyear: float
    v_mag: float
    b_v: float | None
    proper_motion_rad_yr: float | None
    parallax_rad: float | None
    flags: list[str]
    catalogues: list[Catalogue]
    checked_catalogues: int
    unnumbered: int
    frames: list[MatchedFrame]
    checked_frames: int


class StarCards:
    """Collects the facts of stars."""

    def __init__(self, database: Database, now: Now) -> None:
        self._database, self._now = database, now

    def card(self, hip: int) -> StarCard:
        """Return the facts of a star at the present epoch. Raises NotFound if the star table does not contain it."""
        table = load_hipparcos()
        table_rows = np.flatnonzero(table.hip == hip)
        if not len(table_rows):
            raise NotFound(
                "The star table does not contain this star",
                expected=f"one of the {len(table)} Hipparcos stars",
                got=f"HIP {hip}",
                hint="search for the star by its name in the palette (Ctrl K)",
            )
        moves = not int(table.flags[table_rows[0]]) & FLAG_NO_PROPER_MOTION
        star = propagate(table.take(table_rows), jyear_of(self._now()))
        (ra, dec), colour = ra_dec_from_unit(star.icrs), float(star.b_v[0])
        with self._database.unit_of_work() as session:
            rows = catalogues.newest(session, MAX_CATALOGUES)
            solved = newest_matches(session, MAX_FRAMES)
        return StarCard(
            hip=hip,
            name=table.name_of(hip),
            other_names=list(other_names().get(hip, ())),
            ra_rad=float(ra[0]),
            dec_rad=float(dec[0]),
            epoch_jyear=star.epoch_jyear if moves else EPOCH_WITHOUT_MOTION_JYEAR,
            v_mag=float(star.v_mag[0]),
            b_v=colour if math.isfinite(colour) else None,
            proper_motion_rad_yr=float(np.linalg.norm(star.proper_motion_rad_yr[0])) if moves else None,
            parallax_rad=float(star.parallax_rad[0]) if moves else None,
            flags=[words for flag, words in FLAG_WORDS.items() if int(star.flags[0]) & flag],
            catalogues=[c for c in rows if hip in _numbers(c)],
            checked_catalogues=len(rows),
            unnumbered=sum(not _numbers(c) for c in rows),
            frames=[MatchedFrame(frame, stars[hip]) for frame, stars in solved if hip in stars],
            checked_frames=len(solved),
        )


def _numbers(row: Catalogue) -> Sequence[int]:
    """Return the Hipparcos numbers of a catalogue's stars, empty if its manifest lists none."""
    numbers: Sequence[int] = row.manifest.get("hip") or ()
    return numbers
