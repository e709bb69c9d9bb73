"""Sub-catalogues: preview and result. The request is gss.operations.catalogues.catalogue_request."""

from __future__ import annotations

from typing import Any, Literal

from pydantic import Field

from gss.api.schemas.base import In, Out, Utc


class ListMappingIn(In):
    """How to read a star list; JSON in a form field. See ``ListMapping`` for the allowed values."""

    columns: dict[str, str] = Field(default_factory=dict)
    units: dict[str, str] = Field(default_factory=dict)
    epoch_jyear: float | None = Field(default=None, allow_inf_nan=False)
    frame: str | None = None
    pm_ra_has_cos_dec: bool = True
    bad_rows: str = "drop"


class FunnelOut(Out):
    """Row of the selection funnel."""

    label: str
    stars: int
    kind: Literal["keep", "drop"]


class SkyStarOut(Out):
    """Star on the map. ``state``: kept, thinned, rejected or outside."""

    hip: int
    ra_deg: float
    dec_deg: float
    v_mag: float
    state: str


class EnvelopeOut(Out):
    """Envelope: fraction of time in the field of view, HEALPix ring order, 0 where never. ``sweep``: field outlines
    along the orbit, with their ``boresights``, over one orbit or the validity; [] for the whole sky and for
    catalogues of older versions."""

    nside: int
    fraction: list[float]
    outline_start: list[list[tuple[float, float]]]
    outline_end: list[list[tuple[float, float]]]
    sweep_over: str = ""
    sweep: list[list[tuple[float, float]]] = Field([])
    boresights: list[tuple[float, float]] = Field([])


class QualityOut(Out):
    """How well the kept stars fill the fields. ``searched``: number of fields examined to find the worst one."""

    pointings: int
    histogram: list[int]
    mean: float
    p_fewer_than_3: float
    p_fewer_than_5: float
    worst_stars: int
    worst_ra_deg: float
    worst_dec_deg: float
    worst_roll_deg: float | None = None
    worst_outline: list[tuple[float, float]] = Field([])
    candidates_per_query: float | None
    candidates_per_star: float | None = None
    blinded_share: float = 0.0
    searched: int = 0


class AmbiguityOut(Out):
    """Ambiguity maps in HEALPix ring order: other triangles per triangle of a field's brightest stars (``value``),
    other pairs per pair (``pairs``); null outside the envelope."""

    nside: int
    tolerance_arcsec: float
    value: list[float | None]
    pairs: list[float | None]
    worst: float | None
    worst_ra_deg: float | None
    worst_dec_deg: float | None


class LifetimeOut(Out):
    """Share of fields inside the envelope by days after the end of validity. ``days`` null: longer than the span examined."""

    threshold: float
    days: float | None
    until: str | None
    days_curve: list[float]
    share_curve: list[float]


class WandererOut(Out):
    """The Sun, or a body that enters the envelope on ``share`` of the days. ``way``: RA and Dec in degrees from first
    to last day."""

    name: str
    brightest_mag: float
    share: float
    way: list[tuple[float, float]]


class ScreenedStarOut(Out):
    """Star on the screening list. ``companions``: other stars in its ring."""

    hip: int
    reasons: list[str]
    companions: int
    kept: bool


class ScreeningOut(Out):
    """Screening list over the envelope: star counts by reason, ring statistics, expected chance stars in the patch of a
    third star (``third``), and the brightest listed stars."""

    action: str
    counts: dict[str, int]
    mean_companions: float
    most_companions: float
    third: float
    stars: list[ScreenedStarOut]


class SizesOut(Out):
    """Bytes of each part of the image, and of the bank."""

    by_part: dict[str, int]
    bank_bytes: int


class PreviewOut(Out):
    """Preview of a build while parameters change. ``bank_source``: origin of ``bank_bytes``: request (asked), sensor,
    or default (usual)."""

    stars: int
    pairs_estimate: int
    bytes_estimate: int
    bank_bytes: int
    bank_source: Literal["asked", "sensor", "usual"]
    funnel: list[FunnelOut]
    sky: list[SkyStarOut]
    envelope: EnvelopeOut
    ambiguity: AmbiguityOut | None
    elapsed_ms: float


class CatalogueOut(Out):
    """Stored catalogue."""

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
    """Stored catalogue with its request, manifest, maps and quality report. ``instrument_version``: SHA-256 of the instrument
    package that it was built with; null: unknown."""

    instrument_version: str | None
    request: dict[str, Any]
    manifest: dict[str, Any]
    funnel: list[FunnelOut]
    sky: list[SkyStarOut]
    envelope: EnvelopeOut | None
    quality: QualityOut | None
    ambiguity: AmbiguityOut | None
    lifetime: LifetimeOut | None
    sizes: SizesOut | None
    blinded: dict[str, float]
    wanderers: list[WandererOut]
    screening: ScreeningOut | None = None
    reduced_stars: int | None = None


class UploadIn(In):
    """Inactive bank to send a catalogue to; read-back verification and commit follow automatically."""

    bank: str = Field(pattern="^[A-Z]$")
