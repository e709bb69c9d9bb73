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
    """Sun or Moon, geocentric, with the angle the boresight should keep."""

    name: str
    ra_deg: float
    dec_deg: float
    exclusion_deg: float


class SkyOut(Out):
    """Stars and bodies of a chart."""

    utc: Utc
    stars: list[ChartStarOut]
    bodies: list[BodyOut]


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
