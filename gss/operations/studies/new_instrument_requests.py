"""Request for an instrument from photographs, in user units: of the API, the command line and the job store."""

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
    """What is known of the camera. ``name``: of the new instrument. ``model``: instrument from which link, dictionary, formats and
    simulated unit are copied; "": none, and the package describes the camera alone. ``fov_min_deg``, ``fov_max_deg``: range of the
    horizontal field of view. ``exposure_s``, ``date``: of photographs that do not state theirs. ``atmosphere``: False if they
    were taken in space or simulated."""

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
            raise ValueError(f"date is not a day of the calendar: {error}") from None
        if taken is not None and not EPOCH_RANGE_JYEAR[0] <= taken.year < EPOCH_RANGE_JYEAR[1]:
            raise ValueError(f"date must be between {EPOCH_RANGE_JYEAR[0]:g} and {EPOCH_RANGE_JYEAR[1]:g}")
        return self

    @property
    def taken(self) -> datetime | None:
        """Noon of the stated day, UTC; None if no date is stated."""
        return None if self.date is None else datetime.fromisoformat(f"{self.date}T12:00:00+00:00")

    @property
    def fov_limits_rad(self) -> tuple[float, float] | None:
        """Range of the horizontal field of view, None if unknown."""
        if self.fov_min_deg is None or self.fov_max_deg is None:
            return None
        return math.radians(self.fov_min_deg), math.radians(self.fov_max_deg)


class PhotographsRequest(PhotographOptions):
    """Make an instrument from stored frames."""

    frame_ids: Annotated[list[Id], Field(min_length=FEWEST, max_length=MAX_PHOTOGRAPHS)]

    @model_validator(mode="after")
    def _different(self) -> Self:
        if len(set(self.frame_ids)) < len(self.frame_ids):
            raise ValueError("a frame appears twice")
        return self
