"""Sub-catalogues: build request, preview and result."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field

from gss.api.schemas.base import Id, In, Out, Utc

Angle = Annotated[float, Field(ge=-1e4, le=1e4)]
"""Angle in degrees; the range excludes NaN and infinity."""
Range = Annotated[list[Angle], Field(min_length=2, max_length=2)]
"""Smallest and largest value, degrees."""
Mounting = Annotated[list[Annotated[float, Field(ge=-1.1, le=1.1)]], Field(min_length=9, max_length=9)]
Turns = Annotated[list[Angle], Field(min_length=3, max_length=3)]
Law = Literal["sunsat", "zenith", "nadir", "target", "inertial", "anti_sun", "sun_pointing"]


class CorrectionsIn(In):
    """Corrections applied to the source stars. ``doubles``: treatment of stars that the camera cannot separate."""

    proper_motion: bool = True
    parallax: bool = False
    annual_aberration: bool = False
    orbital_aberration: bool = False
    frame: Literal["icrs", "of_date", "b1950"] = "icrs"
    e_terms: bool = True
    instrument_magnitude: bool = False
    roll_off: Literal["off", "average", "worst"] = "off"
    doubles: Literal["", "moniteq", "huffman", "erlank_combine", "erlank_keep", "drop"] = ""
    doubles_separation_deg: float | None = Field(default=None, gt=0, lt=5)
    flag_variables: bool = False
    variables_at_date: bool = False


class OccultationIn(In):
    """Occultation of the sky. Angles in degrees from the boresight; null: the camera's own baffle."""

    earth: bool = False
    earth_margin_deg: float = Field(default=0.0, ge=0, le=60)
    sun: bool = False
    sun_deg: float | None = Field(default=None, gt=0, lt=180)
    moon: bool = False
    moon_deg: float | None = Field(default=None, gt=0, lt=180)


class ScreeningIn(In):
    """Rules of the screening list. ``action``: off, list (only name the stars) or drop. Reasons: close doubles,
    variables, high proper motion. A star is also listed if the ring at ``arc_deg`` ± ``tolerance_deg`` holds more
    than ``most_companions`` stars, or if more than ``most_false`` false triples are expected."""

    action: Literal["off", "list", "drop"] = "off"
    doubles: bool = True
    variables: bool = True
    fast: bool = True
    most_companions: int | None = Field(default=None, ge=0, le=100_000)
    most_false: float | None = Field(default=None, ge=0, le=1e6)
    arc_deg: float = Field(default=8.0, gt=0, lt=180)
    tolerance_deg: float = Field(default=0.01, gt=0, le=10)


class ReducedIn(In):
    """Frame of a reduced catalogue: it keeps the ``brightest`` stars of every upright frame of this size; frames are
    ``step_deg`` apart."""

    width_deg: float = Field(ge=1, le=120)
    height_deg: float = Field(ge=1, le=120)
    brightest: int = Field(default=8, ge=1, le=100)
    step_deg: float = Field(default=1.0, ge=0.25, le=10)


class CatalogueIn(In):
    """Build request. Angles in degrees. ``orbit``: none = whole sky, unless ``pointing`` needs no orbit.
    ``altitude_km``: with elements, the node drifts over the days of use; without it the node limits are fixed.
    ``body_from_cam``: nine numbers by rows, replacing the law's own mounting. ``mounting_deg``: alternatively three
    rotations, about x, y and z in this order, that take the body axes to the camera axes. ``off_nadir_deg``:
    off-nadir angle of a target law. ``thinning``: shape of the fields that keep ``brightest_per_field`` stars:
    circles, or upright frames of the camera's shape. ``reduced`` null: no reduced catalogue, unless the format
    requires one; then with the camera's frame."""

    name: str = Field(default="", max_length=60)
    profile: str = "cubestar"
    format: str = "cubestar"
    orbit: Literal["none", "elements", "tle"] = "none"
    inclination_deg: float = Field(default=97.6, ge=0, le=180)
    raan_deg: Range = Field(default=[0.0, 360.0])
    altitude_km: float | None = Field(default=None, ge=100, le=1_000_000)
    tle: str = Field(default="", max_length=400)
    start: str = ""
    days: float = Field(default=14, gt=0, le=400)
    pointing: Law = "zenith"
    roll_deg: Range = Field(default=[-5.0, 5.0])
    pitch_deg: Range = Field(default=[-5.0, 5.0])
    yaw_deg: Range = Field(default=[-5.0, 5.0])
    ra_deg: float = Field(default=0.0, ge=-360, le=720)
    dec_deg: float = Field(default=0.0, ge=-90, le=90)
    field_roll_deg: float = Field(default=0.0, ge=-360, le=360)
    off_nadir_deg: float = Field(default=0.0, ge=0, le=80)
    body_from_cam: Mounting | None = None
    mounting_deg: Turns | None = None
    margin_deg: float = Field(default=0.5, ge=0, le=20)
    method: Literal["exact", "blocks"] = "exact"
    source: Literal["hipparcos", "hipparcos_all", "gaia", "list"] = "hipparcos"
    star_list: Id | None = None
    corrections: CorrectionsIn = CorrectionsIn()
    occultation: OccultationIn = OccultationIn()
    epoch_jyear: float | None = Field(default=None, ge=1800, le=2200)
    faint_mag: float = Field(default=3.8, ge=-2, le=21)
    bright_mag: float = Field(default=-2.0, ge=-3, le=21)
    min_separation_deg: float = Field(default=0.0, ge=0, le=5)
    brightest_per_field: int = Field(default=0, ge=0, le=500)
    thinning: Literal["circles", "frames"] = "circles"
    drop_variables: bool = False
    screening: ScreeningIn = ScreeningIn()
    reduced: ReducedIn | None = None
    pair_min_deg: float = Field(default=0.25, ge=0, le=20)
    pair_max_deg: float | None = Field(default=None, gt=0, le=120)
    bank_bytes: int | None = Field(default=None, ge=64, le=1 << 30)
    k_vector: bool = False


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
    """Stored catalogue with its request, manifest, maps and quality report."""

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
