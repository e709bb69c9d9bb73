"""Sub-catalogues: the builder's request, its preview, its result."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field

from gss.api.schemas.base import In, Out, Utc

Range = Annotated[list[float], Field(min_length=2, max_length=2)]
"""Smallest and largest, degrees."""


class CatalogueIn(In):
    """What the builder's five steps collect. Angles in degrees. ``orbit``: none = whole sky."""

    name: str = Field(default="", max_length=60)
    profile: str = "cubestar"
    format: str = "cubestar"
    orbit: Literal["none", "elements", "tle"] = "none"
    inclination_deg: float = Field(default=97.6, ge=0, le=180)
    raan_deg: Range = Field(default=[0.0, 360.0])
    tle: str = Field(default="", max_length=400)
    start: str = ""
    days: float = Field(default=14, gt=0, le=400)
    pointing: Literal["sunsat", "zenith", "nadir"] = "zenith"
    roll_deg: Range = Field(default=[-5.0, 5.0])
    pitch_deg: Range = Field(default=[-5.0, 5.0])
    yaw_deg: Range = Field(default=[-5.0, 5.0])
    margin_deg: float = Field(default=0.5, ge=0, le=20)
    faint_mag: float = Field(default=3.8, ge=-2, le=8)
    bright_mag: float = Field(default=-2.0, ge=-3, le=8)
    min_separation_deg: float = Field(default=0.0, ge=0, le=5)
    brightest_per_field: int = Field(default=0, ge=0, le=500)
    drop_variables: bool = False
    pair_min_deg: float = Field(default=0.25, ge=0, le=20)
    pair_max_deg: float | None = Field(default=None, gt=0, le=120)


class FunnelOut(Out):
    """One line of the funnel of counts."""

    label: str
    stars: int
    kind: Literal["keep", "drop"]


class SkyStarOut(Out):
    """A star of the map. ``state``: kept, thinned, rejected, outside."""

    hip: int
    ra_deg: float
    dec_deg: float
    v_mag: float
    state: str


class EnvelopeOut(Out):
    """HEALPix ring-order fraction of time in the field, 0 where never."""

    nside: int
    fraction: list[float]
    outline_start: list[list[tuple[float, float]]]
    outline_end: list[list[tuple[float, float]]]


class QualityOut(Out):
    """How well the kept stars fill the fields."""

    pointings: int
    histogram: list[int]
    mean: float
    p_fewer_than_3: float
    p_fewer_than_5: float
    worst_stars: int
    worst_ra_deg: float
    worst_dec_deg: float
    candidates_per_query: float | None


class PreviewOut(Out):
    """The builder's answer while parameters change."""

    stars: int
    pairs_estimate: int
    bytes_estimate: int
    funnel: list[FunnelOut]
    sky: list[SkyStarOut]
    envelope: EnvelopeOut
    elapsed_ms: float


class CatalogueOut(Out):
    """A built catalogue in the store."""

    id: int
    name: str
    profile: str
    format: str
    created: Utc
    author: str
    stars: int
    pairs: int
    bytes: int
    sha256: str
    valid_from: Utc | None
    valid_to: Utc | None
    banks: list[str]


class CatalogueDetailOut(CatalogueOut):
    """A built catalogue with its request, manifest, map and quality report."""

    request: dict[str, Any]
    manifest: dict[str, Any]
    funnel: list[FunnelOut]
    sky: list[SkyStarOut]
    envelope: EnvelopeOut | None
    quality: QualityOut | None


class UploadIn(In):
    """Send a catalogue to an inactive bank; verify by read-back and commit follow by themselves."""

    bank: str = Field(pattern="^[A-Z]$")
