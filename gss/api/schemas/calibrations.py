"""Calibrations of cameras: ask, list, read, compare."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field

from gss.api.schemas.base import In, Out, Utc
from gss.api.schemas.reports import ReportViewOut

FrameIds = Annotated[list[Annotated[int, Field(ge=1, le=2**31 - 1)]], Field(max_length=2000)]


class StarCalibrationIn(In):
    """Calibrate from frames of stars. ``profile`` "": a camera that nobody described. ``fov_deg``: its width, where known."""

    kind: Literal["stars"]
    profile: str = Field(default="", max_length=40)
    frame_ids: FrameIds
    models: list[Annotated[str, Field(max_length=20)]] = Field(default=[], max_length=10)
    photometry: bool = True
    psf: bool = True
    fov_deg: float | None = Field(default=None, gt=0.5, lt=120)
    name: str = Field(default="", max_length=80)
    note: str = Field(default="", max_length=2000)


class DetectorCalibrationIn(In):
    """Calibrate the detector from dark frames and pairs of flat fields."""

    kind: Literal["detector"]
    profile: str = Field(max_length=40)
    dark_ids: FrameIds
    flat_pairs: list[Annotated[list[Annotated[int, Field(ge=1)]], Field(min_length=2, max_length=2)]] = Field(
        default=[], max_length=200
    )
    name: str = Field(default="", max_length=80)
    note: str = Field(default="", max_length=2000)


CalibrationIn = Annotated[StarCalibrationIn | DetectorCalibrationIn, Field(discriminator="kind")]


class CalibrationOut(Out):
    """One version. ``in_use``: reruns take this camera. ``places``: where the sensor holds it, "a (active)"."""

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
    """A version with everything that was found."""

    request: dict[str, Any]
    values: dict[str, Any]
    result: dict[str, Any]
    report: ReportViewOut


class DocumentedIn(In):
    """The camera whose documented values are used again."""

    profile: str = Field(max_length=40)


class ChangeOut(Out):
    """A value before and after."""

    name: str
    older: float | str | None
    newer: float | str | None


class CalibrationDiffOut(Out):
    """Two versions side by side; the geometry over the detector after the best common rotation."""

    older: int
    newer: int
    rms_px: float
    max_px: float
    rotation_arcsec: list[float]
    changed: list[ChangeOut]
