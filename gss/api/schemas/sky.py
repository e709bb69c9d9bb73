"""The sky for charts."""

from __future__ import annotations

from gss.api.schemas.base import Out, Utc


class ChartStarOut(Out):
    """A bright star."""

    hip: int
    name: str
    ra_deg: float
    dec_deg: float
    v_mag: float


class BodyOut(Out):
    """Sun, Moon or, where the camera's place is known, the Earth. ``exclusion_deg``: angle that the boresight should keep from
    the centre, from the limb for the Earth; ``radius_deg``: how large the body looks (0 where that does not matter)."""

    name: str
    ra_deg: float
    dec_deg: float
    exclusion_deg: float
    radius_deg: float = 0.0


class SkyOut(Out):
    """Stars and bodies of a chart. ``place``: how the camera's place is known; without one it is empty and there is no Earth."""

    utc: Utc
    place: str
    stars: list[ChartStarOut]
    bodies: list[BodyOut]


class FigureOut(Out):
    """A constellation. ``lines``: rows of (right ascension, declination) in degrees, each joined with the next."""

    name: str
    lines: list[list[tuple[float, float]]]


class ProfileOut(Out):
    """A camera profile."""

    name: str
    title: str
    columns: int
    rows: int
    fov_deg: tuple[float, float]
    focal_mm: float
    faint_mag: float
    bits: int
    formats: list[str]
