"""Requests for calibrations in user units, for the API, the command line and the job store."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from gss.domain.errors import BadInput
from gss.domain.json_object import JsonObject
from gss.operations.jobs import JobRequest
from gss.operations.requests import Id, Request
from gss.operations.studies.calibrate import check_models

MAX_FRAMES = 2000
LARGEST = 1e6
FrameIds = Annotated[list[Id], Field(max_length=MAX_FRAMES)]
Measured = Annotated[float, Field(ge=-LARGEST, le=LARGEST)]
"""A measured value. The range excludes NaN and infinities."""


class _Calibration(Request):
    """Fields common to all calibrations. ``frames``: ids of the frames, without flat fields."""

    name: str = Field(default="", max_length=80)
    note: str = Field(default="", max_length=2000)

    @property
    def frames(self) -> list[int]:
        return []


class StarCalibration(_Calibration):
    """Calibration from star frames. ``profile``: "" for a camera without a profile, which is solved blind. ``models``:
    lens models to compare, empty for all. ``fov_deg``: width of the field of view, None if unknown."""

    kind: Literal["stars"]
    profile: str = Field(default="", max_length=40)
    frame_ids: FrameIds
    models: list[Annotated[str, Field(max_length=20)]] = Field(default=[], max_length=10)
    photometry: bool = True
    psf: bool = True
    fov_deg: float | None = Field(default=None, gt=0.5, lt=120)
    prior_ids: list[Id] = Field(default=[], max_length=10, description="Bench calibrations used as priors.")

    @property
    def frames(self) -> list[int]:
        return self.frame_ids

    @property
    def fov_rad(self) -> float | None:
        """Width of the field of view in radians; None if unknown."""
        return None if self.fov_deg is None else math.radians(self.fov_deg)

    @model_validator(mode="after")
    def _possible(self) -> Self:
        check_models(self.models)
        check_frames("frames", self.frame_ids, 1)
        return self


class DetectorCalibration(_Calibration):
    """Detector calibration from dark frames of one exposure and pairs of flat fields."""

    kind: Literal["detector"]
    profile: str = Field(max_length=40)
    dark_ids: FrameIds
    flat_pairs: list[Annotated[list[Id], Field(min_length=2, max_length=2)]] = Field(default=[], max_length=200)

    @property
    def frames(self) -> list[int]:
        return self.dark_ids

    @model_validator(mode="after")
    def _possible(self) -> Self:
        check_frames("dark frames", self.dark_ids, 3)
        return self


class BenchCalibration(_Calibration):
    """Fields common to all bench calibrations. ``profile``: "" for a method that needs no camera."""

    profile: str = Field(max_length=40)


class _BenchFrames(BenchCalibration):
    """Bench calibration from pictures."""

    frame_ids: FrameIds

    @property
    def frames(self) -> list[int]:
        return self.frame_ids

    @model_validator(mode="after")
    def _possible(self) -> Self:
        check_frames("frames", self.frame_ids, 1)
        return self


def _rows(columns: int, description: str) -> Any:
    row = Annotated[list[Measured], Field(min_length=columns, max_length=columns)]
    return Annotated[list[row], Field(min_length=1, max_length=5000, description=description)]


class BenchCentre(BenchCalibration):
    """Optical centre from positions of one dot while the camera is rotated."""

    kind: Literal["bench-centre"]
    dots_px: _rows(2, "[col, row] at each rotation")  # type: ignore[valid-type]  # a type created by a call


class BenchSecondLens(_BenchFrames):
    """Principal point from pictures through a second, identical lens that faces the lens of the camera."""

    kind: Literal["bench-second-lens"]


class BenchTilt(BenchCalibration):
    """Detector tilt from positions of two dots."""

    kind: Literal["bench-tilt"]
    pairs_px: _rows(4, "[inner col, inner row, outer col, outer row] at each rotation")  # type: ignore[valid-type]  # a type created by a call


class BenchFocal(_BenchFrames):
    """Focal length from pairs of stars."""

    kind: Literal["bench-focal"]
    radius_px: float | None = Field(default=None, gt=1, lt=20000)


class BenchRadial(_BenchFrames):
    """Lens distortion polynomial from the distances of stars to a star near the centre."""

    kind: Literal["bench-radial"]
    order: int = Field(default=3, ge=1, le=4)


class BenchCheckerboard(_BenchFrames):
    """Camera model from pictures of a checkerboard. ``corners``: inner corners across and down; ``square_mm``: side of
    a square."""

    kind: Literal["bench-checkerboard"]
    corners: Annotated[list[Annotated[int, Field(ge=3, le=100)]], Field(min_length=2, max_length=2)]
    square_mm: float = Field(gt=0, le=10000)
    fit_k3: bool = False


class BenchDarkLaw(BenchCalibration):
    """Dark current as a function of temperature."""

    kind: Literal["bench-dark-law"]
    points: _rows(2, "[temperature in °C, dark current in electrons per second]")  # type: ignore[valid-type]  # a type created by a call


class BenchFocus(BenchCalibration):
    """Best focus, from pictures at several lens settings, in the order of ``positions``, or from measured star
    widths."""

    kind: Literal["bench-focus"]
    frame_ids: FrameIds = Field(default=[])
    positions: list[Measured] = Field(default=[], max_length=MAX_FRAMES)
    widths: list[Annotated[list[Measured], Field(min_length=2, max_length=2)]] = Field(
        default=[], max_length=5000, description="[setting, σ in px]"
    )
    wished_sigma_px: float = Field(default=0.45, gt=0, lt=50)

    @property
    def frames(self) -> list[int]:
        return self.frame_ids

    @model_validator(mode="after")
    def _possible(self) -> Self:
        if not self.widths:
            check_frames("frames", self.frame_ids, 1)
        return self


WITHOUT_CAMERA = (BenchCentre, BenchSecondLens, BenchCheckerboard)
"""Bench requests that need no profile of the camera."""

CalibrationRequest = Annotated[
    StarCalibration
    | DetectorCalibration
    | BenchCentre
    | BenchSecondLens
    | BenchTilt
    | BenchFocal
    | BenchRadial
    | BenchCheckerboard
    | BenchDarkLaw
    | BenchFocus,
    Field(discriminator="kind"),
]


def check_frames(purpose: str, ids: Sequence[int], fewest: int) -> None:
    """Raise BadInput if there are too few or too many frames, or duplicates."""
    if not fewest <= len(ids) <= MAX_FRAMES or len(set(ids)) != len(ids):
        raise BadInput(
            f"{purpose} cannot be used",
            expected=f"{fewest} to {MAX_FRAMES} different frames",
            got=f"{len(ids)}, {len(set(ids))} different",
        )


@dataclass(frozen=True)
class CalibrationJob(JobRequest):
    """Job request of a calibration."""

    wanted: CalibrationRequest


MEASURED = {"bench-centre": "dots_px", "bench-tilt": "pairs_px", "bench-dark-law": "points", "bench-focus": "widths"}
"""Field of a bench request that contains its measurements."""


def earlier_request(stored: JsonObject) -> JsonObject:
    """Convert a request stored by version 0.4, which contains radians and stores the name separately."""
    if "name" not in stored:
        return stored
    old_request = dict(stored["wanted"])
    new_request: JsonObject = {"profile": old_request["profile"], "name": stored["name"], "note": stored["note"]}
    if "dark_ids" in old_request:
        new_request |= {
            "kind": "detector",
            "dark_ids": old_request["dark_ids"],
            "flat_pairs": old_request["flat_pairs"],
        }
    elif "options" in old_request:
        pictures = {"frame_ids": old_request["frame_ids"], "positions": old_request["positions"]}
        new_request |= (
            {"kind": old_request["kind"]}
            | {name: ids for name, ids in pictures.items() if ids}
            | old_request["options"]
        )
        new_request |= {MEASURED[old_request["kind"]]: old_request["rows"]} if old_request["rows"] else {}
    else:
        fov_rad = old_request.pop("fov_rad", None)
        new_request = (
            old_request | new_request | {"kind": "stars", "fov_deg": None if fov_rad is None else math.degrees(fov_rad)}
        )
    return {"wanted": new_request, "user": stored.get("user", "")}
