"""Results and comparisons of camera calibrations; the requests are gss.operations.studies.calibration_requests."""

from __future__ import annotations

from pydantic import Field

from gss.api.schemas.base import In, Out, Utc
from gss.domain.json_object import JsonObject
from gss.operations.report.parts import Report


class CalibrationOut(Out):
    """Calibration. ``in_use``: reruns use this camera. ``places``: banks of the sensor that hold it, such as "a, active"."""

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
    """Calibration with all its results."""

    request: JsonObject
    values: JsonObject
    result: JsonObject
    report: Report


class DocumentedIn(In):
    """Camera whose documented values are to be used again."""

    profile: str = Field(max_length=40)


class ChangeOut(Out):
    """Value before and after."""

    name: str
    older: float | str | None
    newer: float | str | None


class CalibrationDiffOut(Out):
    """Comparison of two calibrations. Geometry differences are over the detector, after the best common rotation."""

    older: int
    newer: int
    rms_px: float
    max_px: float
    rotation_arcsec: list[float]
    changed: list[ChangeOut]
