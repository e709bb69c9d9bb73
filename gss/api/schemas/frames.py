"""Frames and their solutions."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from gss.api.schemas.base import MAX_ID, In, Out, Utc
from gss.domain.failure_cause import FailureCause
from gss.domain.json_object import JsonObject
from gss.operations.frames.overlay import GridLine, PredictedStar, RegionOverlay
from gss.operations.requests import ChainOptions


class AttitudeOut(Out):
    """Boresight and roll in degrees; quaternion scalar-last, cam_from_icrs; sigma in arcseconds (null if unknown)."""

    ra_deg: float
    dec_deg: float
    roll_deg: float
    quaternion: tuple[float, float, float, float]
    sigma_cross_arcsec: float | None
    sigma_roll_arcsec: float | None


class FrameOut(Out):
    """Stored frame with its operational ground result (``verdict`` to ``attitude``). ``part``: empty, thumbnail, region
    or star_windows; ``held``: rectangles (first column, first row, columns, rows) with received pixels if only a part
    was downloaded; empty otherwise. ``time_known``: false if the imported file or the device states no time; ``taken`` is
    then the time of the import or download."""

    id: int
    number: int | None
    slot: int | None
    source: Literal["device", "import"]
    name: str
    taken: Utc
    time_known: bool
    received: Utc
    columns: int
    rows: int
    bits: int
    exposure_s: float | None
    profile: str | None
    mode: str | None
    sha256: str
    complete: bool
    part: str
    held: list[tuple[int, int, int, int]]
    rows_held: list[tuple[int, int]]
    contact_id: int | None
    verdict: str | None
    outcome: str | None
    chain: str | None
    camera_name: str | None
    matched: int | None
    centroids: int | None
    attitude: AttitudeOut | None
    pixels_removed: Utc | None
    favourite: bool


class FramePage(Out):
    """Page of the frame list, newest first. ``modes``: camera modes of all stored frames, for the filter."""

    total: int
    modes: list[str]
    frames: list[FrameOut]


class StarOut(Out):
    """Centroid with its matched star, if it has one. ``dx/dy_arcsec``: measured − predicted. A planet has a name and no
    ``hip``."""

    index: int
    col_px: float
    row_px: float
    flux_dn: float
    peak_dn: float
    area_px: int
    hip: int | None
    name: str | None
    v_mag: float | None
    dx_px: float | None
    dy_px: float | None
    dx_arcsec: float | None
    dy_arcsec: float | None
    weight: float | None


class SolutionOut(Out):
    """Result of a chain or of the device for one frame. ``camera_name``: assumed camera profile, "field of view" or
    "blind"; empty if stored by an older version. ``operational``: true for the ground result of the frame that pages
    and exports use. ``options``: changed constants of the chain, NAME=VALUE, …; empty: none."""

    id: int
    frame_id: int
    origin: Literal["on board", "ground"]
    chain: str
    version: str
    created: Utc
    outcome: Literal["solved", "none"]
    reason: str
    attitude: AttitudeOut | None
    found: int
    matched: int
    rejected: int
    rms_px: float | None
    rms_arcsec: float | None
    false_match_probability: float | None
    fov_deg: tuple[float, float] | None
    timing_ms: dict[str, float]
    verdict: Literal["correct", "imprecise", "wrong", "none"] | None
    error_axis_arcsec: float | None
    error_roll_arcsec: float | None
    replay: str | None
    notes: list[str]
    camera_name: str
    operational: bool
    options: str


class CameraOut(Out):
    """Camera geometry used for a result. ``distortion``: name and coefficients of the model, for example Brown
    (docs/conventions.md)."""

    columns: int
    rows: int
    focal_col_px: float
    focal_row_px: float
    centre_col_px: float
    centre_row_px: float
    distortion: JsonObject


class TurningOut(Out):
    """Angular velocity of the camera relative to the stars during the exposure, about camera x, y, z, measured from
    star trails."""

    deg_s: tuple[float, float, float]
    sigma_deg_s: tuple[float | None, float | None, float | None]
    speed_deg_s: float
    stars: int
    sign_known: bool


class SolutionDetailOut(SolutionOut):
    """Solution with all overlay data. ``cause``: cause of a failure that the solver has determined, or "".
    ``aberration_arcsec``: largest corrected aberration shift; null: not corrected.
    ``versions``: versions of the code used, by name."""

    cause: FailureCause
    turning: TurningOut | None
    aberration_arcsec: float | None
    versions: dict[str, str]
    regions: list[RegionOverlay]
    stars: list[StarOut]
    predicted: list[PredictedStar]
    grid: list[GridLine]
    north: tuple[float, float] | None
    field: list[tuple[float, float]]
    camera: CameraOut


class ComparisonOut(Out):
    """On-board minus ground attitude in arcseconds."""

    d_ra_arcsec: float
    d_dec_arcsec: float
    d_roll_arcsec: float
    cross_arcsec: float
    agree: bool
    text: str


class DifferenceOut(ComparisonOut):
    """On-board minus ground attitude of one frame."""

    frame_id: int
    taken: Utc


class FrameDetailOut(FrameOut):
    """Frame with its solutions (newest first) and the comparison of the on-board with the operational ground result.
    ``instrument_version``: SHA-256 of the instrument package that was active when the frame was stored; null:
    unknown. ``same_as``: id of the first earlier frame with the same pixels; null: none."""

    solutions: list[SolutionOut]
    on_board: SolutionDetailOut | None
    ground: SolutionDetailOut | None
    comparison: ComparisonOut | None
    truth: AttitudeOut | None
    instrument_version: str | None
    same_as: int | None


class SolveIn(In):
    """Chain to run on a stored frame. Set ``profile`` or ``fov_deg``. If both are missing, the profile of the frame is
    used; a frame without a profile is solved blind. ``options``: changed constants of the chain. ``store``: false for a
    preview, which has the id 0 and is not stored."""

    chain: str = "reference"
    profile: str | None = None
    fov_deg: float | None = Field(default=None, gt=0.2, lt=120)
    blind: bool = False
    aberration: bool | None = Field(
        default=None, description="Correct aberration. Default: true if the frame's time is known."
    )
    options: ChainOptions = Field(default_factory=dict)
    store: bool = True


class PinIn(In):
    """Stored solution that becomes the frame's operational ground result."""

    solution_id: int = Field(ge=1, le=MAX_ID)


class DownloadIn(In):
    """Image memory slot to download."""

    slot: int = Field(ge=0, le=255)
    kind: Literal["frame", "thumbnail"] = "frame"


class PixelsOut(Out):
    """Rectangle of raw values for the pixel inspector."""

    col: int
    row: int
    columns: int
    rows: int
    values: list[list[float | None]]


class HistogramOut(Out):
    """Histogram of pixel values, and a stretch that shows stars."""

    edges: list[float]
    counts: list[int]
    low: float
    high: float
