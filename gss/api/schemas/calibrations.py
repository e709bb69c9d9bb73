"""Results and comparisons of camera calibrations. The requests are in gss.operations.studies.calibration_requests."""

from __future__ import annotations

from pydantic import Field

from gss.api.schemas.base import In, Out, Utc
from gss.domain.json_object import JsonObject
from gss.operations.report.parts import Report


class CalibrationOut(Out):
    """Calibration. ``in_use``: true if reruns use this calibration. ``places``: banks of the sensor that contain it,
    for example "a, active"."""

    id: int
    profile: str
    kind: str
    name: str
    created: Utc
    author: str
    tool: str
    note: str
    frames: int
    in_use: bool
    sendable: bool
    table_id: int | None
    places: list[str]
    warnings: int
    model: str | None
    rms_px: float | None
    rms_before_px: float | None
    focal_px: float | None


class CalibrationDetailOut(CalibrationOut):
    """Calibration with its results and report. ``bad_pixels``: number of bad pixels; ``bad_pixel_places``: banks of the
    sensor that contain their table; ``no_bad_pixel_table``: the reason if the sensor has no such table."""

    bad_pixels: int
    bad_pixel_table_id: int | None
    bad_pixel_places: list[str]
    no_bad_pixel_table: str
    request: JsonObject
    values: JsonObject
    result: JsonObject
    report: Report


class DocumentedIn(In):
    """Camera that returns to its documented values."""

    profile: str = Field(max_length=40)


class ChangeOut(Out):
    """Older and newer value of a parameter."""

    name: str
    older: float | str | None
    newer: float | str | None


class CalibrationDiffOut(Out):
    """Comparison of two calibrations. Geometry differences are calculated over the detector after the best-fit rotation
    is removed."""

    older: int
    newer: int
    rms_px: float
    max_px: float
    rotation_arcsec: list[float]
    changed: list[ChangeOut]
