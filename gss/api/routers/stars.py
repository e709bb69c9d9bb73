"""Stars of the Hipparcos catalogue: search and facts."""

from __future__ import annotations

import math
from typing import Annotated

import numpy as np
from fastapi import Query

from gss.api import present
from gss.api.api_router import api_router
from gss.api.deps import App
from gss.api.schemas.stars import FoundStarOut, MatchedFrameOut, StarCardOut, StarSearchOut
from gss.catalogue_tools.envelope.orbits import jyear_of
from gss.catalogue_tools.sources.hipparcos import MAS_RAD, load_hipparcos, other_names, propagate
from gss.catalogue_tools.sources.star_names import find_stars, named_stars
from gss.domain.angles import ra_dec_from_unit
from gss.operations.catalogues.similar_stars import similar_stars
from gss.operations.catalogues.star_card import MatchedFrame

router = api_router("stars", "/stars")


@router.get("")
def search_stars(
    app: App, q: Annotated[str, Query(min_length=1, max_length=60)], limit: Annotated[int, Query(ge=1, le=50)] = 12
) -> StarSearchOut:
    """Search for stars by Hipparcos number, or by proper, Bayer, Flamsteed or variable-star name. Exact matches come
    first, then brighter stars. If no name contains the text, stars whose name differs by one typing error are returned.
    Positions: ICRS at the present epoch."""
    table, hits = load_hipparcos(), find_stars(q, limit) or similar_stars(q, limit)
    found = propagate(table.take(np.array([hit.row for hit in hits], int)), jyear_of(app.base.clock.now()))
    ra, dec = ra_dec_from_unit(found.icrs.reshape(-1, 3))
    stars = [
        FoundStarOut(
            hip=int(table.hip[hit.row]),
            name=table.name_of(int(table.hip[hit.row])),
            other_names=list(other_names().get(int(table.hip[hit.row]), ())),
            ra_deg=math.degrees(float(a)),
            dec_deg=math.degrees(float(d)),
            v_mag=float(table.v_mag[hit.row]),
            exact=hit.exact,
        )
        for hit, a, d in zip(hits, ra, dec, strict=True)
    ]
    return StarSearchOut(stars=stars, table_stars=len(table), named_stars=named_stars())


@router.get("/{hip}")
def read_star(app: App, hip: int) -> StarCardOut:
    """Facts of a star: position, magnitude, and the stored catalogues and recent frames that contain it."""
    card, banks = app.catalogues.stars.card(hip), app.transfers.banks.views()
    # Fields with the same name and meaning are copied. The others are converted to degrees, mas and response models.
    copied = {name: getattr(card, name) for name in StarCardOut.model_fields.keys() & vars(card).keys()}
    converted = {
        "ra_deg": math.degrees(card.ra_rad),
        "dec_deg": math.degrees(card.dec_rad),
        "proper_motion_mas_yr": _mas(card.proper_motion_rad_yr),
        "parallax_mas": _mas(card.parallax_rad),
        "catalogues": [present.catalogues.catalogue(row, banks) for row in card.catalogues],
        "unknown_banks": [bank.bank for bank in banks if bank.sha256 and bank.catalogue is None],
        "frames": [_matched(match) for match in card.frames],
    }
    return StarCardOut.model_validate(copied | converted)


def _mas(value_rad: float | None) -> float | None:
    return None if value_rad is None else value_rad / MAS_RAD


def _matched(match: MatchedFrame) -> MatchedFrameOut:
    frame = match.frame
    return MatchedFrameOut(
        id=frame.id,
        name=frame.name,
        taken=frame.taken,
        time_known=frame.time_known,
        residual_px=match.residual_px,
    )
