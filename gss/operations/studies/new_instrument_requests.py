"""Request for an instrument from photographs in user units, for the API, the command line and the job store."""

from __future__ import annotations

import math
from datetime import datetime
from typing import Annotated, Self

from pydantic import Field, model_validator

from gss.catalogue_tools.sources.hipparcos import EPOCH_RANGE_JYEAR
from gss.instruments.package_files import NAME_PATTERN
from gss.operations.requests import Id, Request
from gss.operations.studies.photographs import FEWEST

MAX_PHOTOGRAPHS = 200


class PhotographOptions(Request):
    """Known properties of the camera. ``name``: name of the new instrument. ``model``: instrument from which link,
    dictionary, formats and simulated unit are copied; "" for a package that describes only the camera. ``fov_min_deg``,
    ``fov_max_deg``: range of the horizontal field of view. ``exposure_s``, ``date``: values for photographs whose files
    do not state them. ``atmosphere``: False if the photographs were taken in space or simulated."""

    name: str = Field(pattern=NAME_PATTERN)
    title: str = Field(default="", max_length=200)
    model: str = Field(default="", max_length=40)
    fov_min_deg: float | None = Field(default=None, ge=1, le=120)
    fov_max_deg: float | None = Field(default=None, ge=1, le=120)
    pixel_um: float | None = Field(default=None, ge=0.1, le=200)
    focal_mm: float | None = Field(default=None, ge=0.1, le=10_000)
    f_number: float | None = Field(default=None, ge=0.1, le=200)
    exposure_s: float | None = Field(default=None, gt=0, le=3600)
    date: str | None = Field(default=None, pattern=r"^\d{4}-\d{2}-\d{2}$")
    atmosphere: bool = True

    @model_validator(mode="after")
    def _range(self) -> Self:
        if (self.fov_min_deg is None) != (self.fov_max_deg is None):
            raise ValueError("fov_min_deg and fov_max_deg belong together")
        if self.fov_min_deg is not None and self.fov_max_deg is not None and self.fov_min_deg > self.fov_max_deg:
            raise ValueError("fov_min_deg is larger than fov_max_deg")
        try:
            taken = self.taken
        except ValueError as error:
            raise ValueError(f"date is not a valid day: {error}") from None
        if taken is not None and not EPOCH_RANGE_JYEAR[0] <= taken.year < EPOCH_RANGE_JYEAR[1]:
            raise ValueError(f"date must be between {EPOCH_RANGE_JYEAR[0]:g} and {EPOCH_RANGE_JYEAR[1]:g}")
        return self

    @property
    def taken(self) -> datetime | None:
        """Noon UTC of the stated day; None if no date is stated."""
        return None if self.date is None else datetime.fromisoformat(f"{self.date}T12:00:00+00:00")

    @property
    def fov_limits_rad(self) -> tuple[float, float] | None:
        """Range of the horizontal field of view in radians; None if unknown."""
        if self.fov_min_deg is None or self.fov_max_deg is None:
            return None
        return math.radians(self.fov_min_deg), math.radians(self.fov_max_deg)


class PhotographsRequest(PhotographOptions):
    """Request for an instrument from stored frames."""

    frame_ids: Annotated[list[Id], Field(min_length=FEWEST, max_length=MAX_PHOTOGRAPHS)]

    @model_validator(mode="after")
    def _different(self) -> Self:
        if len(set(self.frame_ids)) < len(self.frame_ids):
            raise ValueError("a frame id occurs twice")
        return self
