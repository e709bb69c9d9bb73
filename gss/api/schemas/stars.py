"""Search for stars, and the facts of a star."""

from __future__ import annotations

from gss.api.schemas.base import Out, Utc
from gss.api.schemas.catalogues import CatalogueOut
from gss.api.schemas.sky import ChartStarOut


class FoundStarOut(ChartStarOut):
    """Star that matches a search. ``other_names``: further designations; ``exact``: true if the number or a whole name is
    equal to the text."""

    other_names: list[str]
    exact: bool


class StarSearchOut(Out):
    """Result of a search. ``table_stars``: number of stars in the searched table; ``named_stars``: number of them with
    a name."""

    stars: list[FoundStarOut]
    table_stars: int
    named_stars: int


class MatchedFrameOut(Out):
    """Frame whose operational ground result contains a star. ``residual_px``: distance between the measured and the
    predicted position."""

    id: int
    name: str
    taken: Utc
    time_known: bool
    residual_px: float | None


class StarCardOut(Out):
    """Facts of a star. ``other_names``: further designations. Position: ICRS at ``epoch_jyear``. ``b_v``,
    ``proper_motion_mas_yr`` and ``parallax_mas``: null if unknown. ``flags``: known
    properties in words. ``catalogues``: stored catalogues that contain the star; ``checked_catalogues``: number of the
    newest catalogues that were searched; ``unnumbered``: searched catalogues without star numbers, which can contain the
    star; ``unknown_banks``: banks with a content that is not stored on the ground. ``frames``: frames in which the star
    was matched; ``checked_frames``: number of the newest solved frames that were searched."""

    hip: int
    name: str
    other_names: list[str]
    ra_deg: float
    dec_deg: float
    epoch_jyear: float
    v_mag: float
    b_v: float | None
    proper_motion_mas_yr: float | None
    parallax_mas: float | None
    flags: list[str]
    catalogues: list[CatalogueOut]
    checked_catalogues: int
    unnumbered: int
    unknown_banks: list[str]
    frames: list[MatchedFrameOut]
    checked_frames: int
