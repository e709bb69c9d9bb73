"""Camera design: figures, curves and tables. Units are in the names. The request is gss.operations.catalogues.design."""

from __future__ import annotations

from typing import Any, Literal

from gss.api.schemas.base import Out


class DesignFigureOut(Out):
    """Result value. ``paper``: the value in the camera's own document, with its source."""

    group: str
    key: str
    label: str
    value: float | None
    unit: str
    source: str
    paper: float | None
    paper_source: str


class FieldCountOut(Out):
    """Number of pointings with 0, 1, 2 … stars, and the boresight of the first with the fewest."""

    pointings: int
    counts: list[int]
    mean: float
    p_fewer_than_3: float
    p_fewer_than_5: float
    worst_stars: int
    worst_ra_deg: float
    worst_dec_deg: float


class LineOut(Out):
    """Line of a curve; null is a gap."""

    label: str
    x: list[float]
    y: list[float | None]


class UprightOut(Out):
    """Vertical marker on the x axis."""

    label: str
    x: float


class MarkOut(Out):
    """Point printed in a document."""

    x: float
    y: float
    label: str
    source: str


class CurveOut(Out):
    """Curve with one or more lines; axis labels include units."""

    key: str
    title: str
    x_label: str
    y_label: str
    log_x: bool
    log_y: bool
    lines: list[LineOut]
    uprights: list[UprightOut]
    marks: list[MarkOut]


class BaffleOut(Out):
    """Section through a baffle. ``kind``: one or two stages. ``edges_mm``: (z, r) of knife edges; ``walls_mm``: (z, z, r)."""

    kind: Literal["one", "two"]
    lens_radius_mm: float
    half_fov_deg: float
    exclusion_deg: float
    length_mm: float
    front_radius_mm: float
    edges_mm: list[list[float]]
    walls_mm: list[list[float]]


class TradeRowOut(Out):
    """Camera in a trade table; accuracies are medians, 1σ, one axis."""

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


class DesignOut(Out):
    """Design report. ``looks``: number of pointings behind curves and accuracy; ``full`` false: preview without the lens trade."""

    profile: str
    camera: dict[str, Any]
    base: dict[str, Any]
    changed: list[str]
    sky: str
    figures: list[DesignFigureOut]
    histogram: FieldCountOut
    curves: list[CurveOut]
    baffles: list[BaffleOut]
    baffle_problem: str
    trade: list[TradeRowOut]
    cameras: list[TradeRowOut]
    notes: list[str]
    looks: int
    full: bool
    elapsed_ms: float


class FieldLimitOut(Out):
    """Allowed range of a camera field."""

    min: float
    max: float
    unit: str


class DesignCameraOut(Out):
    """Documented camera as a starting point; units are in the field names."""

    name: str
    title: str
    values: dict[str, float]
    sources: dict[str, str]


class DesignCamerasOut(Out):
    """Cameras to start from, and the allowed ranges of the editable fields. ``unit``: camera of the configured instrument."""

    unit: str
    cameras: list[DesignCameraOut]
    rows: list[TradeRowOut]
    limits: dict[str, FieldLimitOut]
