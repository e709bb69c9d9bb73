"""Requests, results and comparisons of camera calibrations."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field

from gss.api.schemas.base import Id, In, Out, Utc
from gss.api.schemas.reports import ReportViewOut

FrameIds = Annotated[list[Id], Field(max_length=2000)]

LARGEST = 1e6
Measured = Annotated[float, Field(ge=-LARGEST, le=LARGEST)]
"""Bench measurement; the range excludes NaN and infinity."""


class StarCalibrationIn(In):
    """Calibration from star frames. ``profile``: "" for a camera without a profile. ``fov_deg``: width of the field of
    view, if known."""

    kind: Literal["stars"]
    profile: str = Field(default="", max_length=40)
    frame_ids: FrameIds
    models: list[Annotated[str, Field(max_length=20)]] = Field(default=[], max_length=10)
    photometry: bool = True
    psf: bool = True
    fov_deg: float | None = Field(default=None, gt=0.5, lt=120)
    prior_ids: list[Id] = Field(
        default=[], max_length=10, description="Calibrations of the bench that say something beforehand."
    )
    name: str = Field(default="", max_length=80)
    note: str = Field(default="", max_length=2000)


class DetectorCalibrationIn(In):
    """Detector calibration from dark frames and pairs of flat fields."""

    kind: Literal["detector"]
    profile: str = Field(max_length=40)
    dark_ids: FrameIds
    flat_pairs: list[Annotated[list[Id], Field(min_length=2, max_length=2)]] = Field(default=[], max_length=200)
    name: str = Field(default="", max_length=80)
    note: str = Field(default="", max_length=2000)


class _BenchIn(In):
    """Fields common to all bench calibrations."""

    profile: str = Field(max_length=40)
    name: str = Field(default="", max_length=80)
    note: str = Field(default="", max_length=2000)


def _rows(columns: int, words: str) -> Any:
    row = Annotated[list[Measured], Field(min_length=columns, max_length=columns)]
    return Annotated[list[row], Field(min_length=1, max_length=5000, description=words)]


class BenchCentreIn(_BenchIn):
    """Optical centre from positions of one dot while the camera is rotated."""

    kind: Literal["bench-centre"]
    dots_px: _rows(2, "[col, row] of each turn")  # type: ignore[valid-type]  # a made type


class BenchTiltIn(_BenchIn):
    """Detector tilt from positions of two dots."""

    kind: Literal["bench-tilt"]
    pairs_px: _rows(4, "[inner col, inner row, outer col, outer row] of each turn")  # type: ignore[valid-type]  # a made type


class BenchFocalIn(_BenchIn):
    """Focal length from pairs of stars."""

    kind: Literal["bench-focal"]
    frame_ids: FrameIds
    radius_px: float | None = Field(default=None, gt=1, lt=20000)


class BenchRadialIn(_BenchIn):
    """Lens distortion polynomial from stars around one near the centre."""

    kind: Literal["bench-radial"]
    frame_ids: FrameIds
    order: int = Field(default=3, ge=1, le=4)


class BenchCheckerboardIn(_BenchIn):
    """Camera model from pictures of a checkerboard. ``corners``: inner corners across and down; ``square_mm``: side of a square."""

    kind: Literal["bench-checkerboard"]
    frame_ids: FrameIds
    corners: Annotated[list[Annotated[int, Field(ge=3, le=100)]], Field(min_length=2, max_length=2)]
    square_mm: float = Field(gt=0, le=10000)
    fit_k3: bool = False


class BenchDarkLawIn(_BenchIn):
    """Dark current as a function of temperature."""

    kind: Literal["bench-dark-law"]
    points: _rows(2, "[temperature in °C, dark current in electrons per second]")  # type: ignore[valid-type]  # a made type


class BenchFocusIn(_BenchIn):
    """Best focus, from pictures at several lens settings or from measured star widths."""

    kind: Literal["bench-focus"]
    frame_ids: list[Id] = Field(default=[], max_length=2000)
    positions: list[Measured] = Field(default=[], max_length=2000)
    widths: list[Annotated[list[Measured], Field(min_length=2, max_length=2)]] = Field(
        default=[], max_length=5000, description="[setting, σ in px]"
    )
    wished_sigma_px: float = Field(default=0.45, gt=0, lt=50)


BenchIn = (
    BenchCentreIn | BenchTiltIn | BenchFocalIn | BenchRadialIn | BenchCheckerboardIn | BenchDarkLawIn | BenchFocusIn
)
CalibrationIn = Annotated[StarCalibrationIn | DetectorCalibrationIn | BenchIn, Field(discriminator="kind")]


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

    request: dict[str, Any]
    values: dict[str, Any]
    result: dict[str, Any]
    report: ReportViewOut


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
