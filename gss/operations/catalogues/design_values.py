"""Values of a design page, as stored with the job and sent to the page. The names contain the units."""

from __future__ import annotations

from typing import Literal

from typing_extensions import TypedDict  # pydantic needs this TypedDict before Python 3.12


class FigureValue(TypedDict):
    """One numeric result. ``paper``: value published in the document of the camera. ``paper_source``: its source."""

    group: str
    key: str
    label: str
    value: float | None
    unit: str
    source: str
    paper: float | None
    paper_source: str


class CountValues(TypedDict):
    """Star counts of the pointings. ``counts``: number of pointings with 0, 1, 2 … stars. ``worst_ra_deg``, ``worst_dec_deg``:
    boresight of the first pointing with the fewest stars."""

    pointings: int
    counts: list[int]
    mean: float
    p_fewer_than_3: float
    p_fewer_than_5: float
    worst_stars: int
    worst_ra_deg: float
    worst_dec_deg: float


class LineValues(TypedDict):
    """A line of a curve. None in ``y`` is a gap."""

    label: str
    x: list[float]
    y: list[float | None]


class UprightValue(TypedDict):
    """A vertical marker line."""

    label: str
    x: float


class MarkValue(TypedDict):
    """A point published in a document."""

    x: float
    y: float
    label: str
    source: str


class CurveValues(TypedDict):
    """A plot with its lines. Axis labels include the units."""

    key: str
    title: str
    x_label: str
    y_label: str
    log_x: bool
    log_y: bool
    lines: list[LineValues]
    uprights: list[UprightValue]
    marks: list[MarkValue]


class BaffleValues(TypedDict):
    """Section through a baffle of one or two stages: knife edges (z, r) and walls (z, z, r)."""

    kind: Literal["one", "two"]
    lens_radius_mm: float
    half_fov_deg: float
    exclusion_deg: float
    length_mm: float
    front_radius_mm: float
    edges_mm: list[list[float]]
    walls_mm: list[list[float]]


class TradeValues(TypedDict):
    """A row of the table of cameras."""

    name: str
    focal_mm: float
    f_number: float
    pupil_mm: float
    fov_deg: list[float]
    pixel_arcsec: float
    limit_mag: float
    saturation_mag: float | None
    stars: float
    p_fewer_3: float
    pointings: int
    cross_arcsec: float | None
    roll_arcsec: float | None
    blur_rate_deg_s: float


CameraValues = dict[str, str | float | None]
"""Field name of a camera to value. None means that the value is computed."""


class FieldLimit(TypedDict):
    """Range and unit of an editable field."""

    min: float
    max: float
    unit: str


class DesignValues(TypedDict):
    """All values of a design page. ``looks``: number of pointings for curves and accuracy. ``full``: False for a quick
    evaluation, which has no lens trade."""

    profile: str
    camera: CameraValues
    base: CameraValues
    changed: list[str]
    sky: str
    figures: list[FigureValue]
    histogram: CountValues
    curves: list[CurveValues]
    baffles: list[BaffleValues]
    baffle_problem: str
    trade: list[TradeValues]
    cameras: list[TradeValues]
    notes: list[str]
    looks: int
    full: bool
    elapsed_ms: float
