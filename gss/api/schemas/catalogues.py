"""Sub-catalogues: the builder's request, its preview, its result."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field

from gss.api.schemas.base import Id, In, Out, Utc

Angle = Annotated[float, Field(ge=-1e4, le=1e4)]
"""Degrees; NaN and infinity lie in no range."""
Range = Annotated[list[Angle], Field(min_length=2, max_length=2)]
"""Smallest and largest, degrees."""
Mounting = Annotated[list[Annotated[float, Field(ge=-1.1, le=1.1)]], Field(min_length=9, max_length=9)]
Turns = Annotated[list[Angle], Field(min_length=3, max_length=3)]
Law = Literal["sunsat", "zenith", "nadir", "target", "inertial", "anti_sun", "sun_pointing"]


class CorrectionsIn(In):
    """What is done to the stars of the source. ``doubles``: how stars are treated that the camera cannot separate."""

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
    """What hides the sky. Angles in degrees from the boresight; None: the camera's own baffle."""

    earth: bool = False
    earth_margin_deg: float = Field(default=0.0, ge=0, le=60)
    sun: bool = False
    sun_deg: float | None = Field(default=None, gt=0, lt=180)
    moon: bool = False
    moon_deg: float | None = Field(default=None, gt=0, lt=180)


class ScreeningIn(In):
    """Which stars are on the screening list. ``action``: off, list (names them), drop. Marks: close doubles, variables, stars
    that move fast. More than ``most_companions`` stars in the ring at ``arc_deg`` ± ``tolerance_deg`` put a star on it, and so
    do more than ``most_false`` expected false triples."""

    action: Literal["off", "list", "drop"] = "off"
    doubles: bool = True
    variables: bool = True
    fast: bool = True
    most_companions: int | None = Field(default=None, ge=0, le=100_000)
    most_false: float | None = Field(default=None, ge=0, le=1e6)
    arc_deg: float = Field(default=8.0, gt=0, lt=180)
    tolerance_deg: float = Field(default=0.01, gt=0, le=10)


class ReducedIn(In):
    """The frame of a reduced catalogue: the ``brightest`` of every upright frame of that size, ``step_deg`` apart."""

    width_deg: float = Field(ge=1, le=120)
    height_deg: float = Field(ge=1, le=120)
    brightest: int = Field(default=8, ge=1, le=100)
    step_deg: float = Field(default=1.0, ge=0.25, le=10)


class CatalogueIn(In):
    """What the builder's five steps collect. Angles in degrees. ``orbit``: none = whole sky, unless ``pointing`` needs none.

    ``altitude_km``: with elements the node drifts through the days of use; without it its limits stay. ``body_from_cam``:
    nine numbers by rows, in place of the law's own mounting, or ``mounting_deg``: three turns, about x, y and z in this order,
    that bring the body's axes to the camera's. ``off_nadir_deg``: how far a target law looks aside. ``thinning``: the fields
    of which ``brightest_per_field`` stay: circles, or upright frames of the camera's shape. ``reduced`` None: no reduced
    catalogue, except where the format has one of its camera's frame.
    """

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
    """How a star list is read, JSON in a form field: see ``ListMapping``, which knows the words."""

    columns: dict[str, str] = Field(default_factory=dict)
    units: dict[str, str] = Field(default_factory=dict)
    epoch_jyear: float | None = Field(default=None, allow_inf_nan=False)
    frame: str | None = None
    pm_ra_has_cos_dec: bool = True
    bad_rows: str = "drop"


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
    """HEALPix ring-order fraction of time in the field, 0 where never. ``sweep``: the field on its way, with its
    ``boresights``, over one orbit or the validity; [] for the whole sky and for catalogues of older versions."""

    nside: int
    fraction: list[float]
    outline_start: list[list[tuple[float, float]]]
    outline_end: list[list[tuple[float, float]]]
    sweep_over: str = ""
    sweep: list[list[tuple[float, float]]] = Field([])
    boresights: list[tuple[float, float]] = Field([])


class QualityOut(Out):
    """How well the kept stars fill the fields. ``searched``: fields that were looked at for the worst one."""

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
    """HEALPix ring-order maps: other triangles per triangle of a field's brightest stars (``value``), other pairs per pair
    (``pairs``); None outside the envelope."""

    nside: int
    tolerance_arcsec: float
    value: list[float | None]
    pairs: list[float | None]
    worst: float | None
    worst_ra_deg: float | None
    worst_dec_deg: float | None


class LifetimeOut(Out):
    """Share of the fields inside the envelope by days after the end of validity. ``days`` None: longer than was looked at."""

    threshold: float
    days: float | None
    until: str | None
    days_curve: list[float]
    share_curve: list[float]


class WandererOut(Out):
    """The Sun, or a body that comes into the envelope on ``share`` of the days; RA and Dec in degrees from first to last."""

    name: str
    brightest_mag: float
    share: float
    way: list[tuple[float, float]]


class ScreenedStarOut(Out):
    """A star of the screening list; ``companions``: others in its ring."""

    hip: int
    reasons: list[str]
    companions: int
    kept: bool


class ScreeningOut(Out):
    """The screening list over the envelope: how many stars by reason, the ring's figures, stars by chance in the patch of a third
    one, and the brightest that are on it."""

    action: str
    counts: dict[str, int]
    mean_companions: float
    most_companions: float
    third: float
    stars: list[ScreenedStarOut]


class SizesOut(Out):
    """Bytes of every part of the image against the bank."""

    by_part: dict[str, int]
    bank_bytes: int


class PreviewOut(Out):
    """The builder's answer while parameters change. ``bank_source``: whose bank ``bank_bytes`` is."""

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
    """A built catalogue with its request, manifest, maps and quality report."""

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
    """Send a catalogue to an inactive bank; verify by read-back and commit follow by themselves."""

    bank: str = Field(pattern="^[A-Z]$")
