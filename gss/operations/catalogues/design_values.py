"""The values of a design page, as stored in its job and sent to the page. Units are in the names."""

from __future__ import annotations

from typing import Literal

from typing_extensions import TypedDict  # pydantic needs this one before Python 3.12


class FigureValue(TypedDict):
    """A figure. ``paper``: the value in the camera's own document, with its source."""

    group: str
    key: str
    label: str
    value: float | None
    unit: str
    source: str
    paper: float | None
    paper_source: str


class CountValues(TypedDict):
    """Number of pointings with 0, 1, 2 … stars, and the boresight of the first with the fewest."""

    pointings: int
    counts: list[int]
    mean: float
    p_fewer_than_3: float
    p_fewer_than_5: float
    worst_stars: int
    worst_ra_deg: float
    worst_dec_deg: float


class LineValues(TypedDict):
    """A line of a curve; None is a gap."""

    label: str
    x: list[float]
    y: list[float | None]


class UprightValue(TypedDict):
    """A vertical marker."""

    label: str
    x: float


class MarkValue(TypedDict):
    """A point printed in a document."""

    x: float
    y: float
    label: str
    source: str


class CurveValues(TypedDict):
    """A curve; labels include units."""

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
    """A row of a table of cameras."""

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
"""The editable fields of a camera by name; None: computed."""


class FieldLimit(TypedDict):
    """Range of an editable field."""

    min: float
    max: float
    unit: str


class DesignValues(TypedDict):
    """All values. ``looks``: number of pointings behind curves and accuracy; ``full`` false: without the lens trade."""

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
