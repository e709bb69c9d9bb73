"""Sky data for charts, and camera profiles."""

from __future__ import annotations

from typing import Literal

from gss.api.schemas.base import Out, Utc


class ChartStarOut(Out):
    """Bright star."""

    hip: int
    name: str
    ra_deg: float
    dec_deg: float
    v_mag: float


class BodyOut(Out):
    """Sun, Moon or, if the camera's position is known, the Earth. ``exclusion_deg``: minimum angle between the
    boresight and the centre of the body, or the limb of the Earth; ``radius_deg``: apparent radius (0 if not
    relevant)."""

    name: str
    ra_deg: float
    dec_deg: float
    exclusion_deg: float
    radius_deg: float = 0.0


class SkyOut(Out):
    """Stars and bodies of a chart. ``place``: source of the camera's position; empty if the position is unknown, in
    which case the Earth is omitted."""

    utc: Utc
    place: str
    stars: list[ChartStarOut]
    bodies: list[BodyOut]


class FigureOut(Out):
    """Constellation. ``lines``: polylines of (right ascension, declination) in degrees."""

    name: str
    lines: list[list[tuple[float, float]]]


class ProfileOut(Out):
    """Camera profile. ``unit``: true for the camera of the configured instrument. ``formats``: catalogue formats, with the
    on-board formats of this camera first."""

    name: str
    title: str
    columns: int
    rows: int
    fov_deg: tuple[float, float]
    focal_mm: float
    faint_mag: float
    bits: int
    formats: list[str]
    unit: bool


class ChainOptionOut(Out):
    """Constant of a chain that a rerun can change. ``value``: value as text, empty: not set. Values of the kind
    ``numbers`` are separated by commas."""

    name: str
    kind: Literal["number", "integer", "word", "yes or no", "numbers"]
    value: str
    source: str
