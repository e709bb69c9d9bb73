"""Angular rates of an image sequence from its stars alone, as LIST measures them (Huffman 2006 Table 1.3)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from datetime import datetime
from typing import Any, NotRequired, TypedDict

import numpy as np
from numpy.typing import NDArray

from gss.domain.camera_profile import CameraProfile
from gss.domain.errors import BadInput
from gss.domain.results import Centroids
from gss.operations.frames.image_sequence import ImageIntervals, RateRecord, rate_record
from gss.pipeline.chains.far_mst_detect import find_centroids
from gss.pipeline.chains.far_mst_parameters import default_parameters
from gss.pipeline.chains.options import with_options
from gss.pipeline.chains.star_rates import StarRate, rate_from_stars
from gss.pipeline.rates import Rate


class StarRateRecord(TypedDict):
    """Rate of the camera since the previous image. ``stars``: detected in this image; ``matched``: matched to the previous
    image with ``method``. ``covariance_deg2_s2``: (3, 3), camera axes. Without a rate, ``reason`` states why."""

    stars: int
    matched: int
    method: str
    reason: str
    false_match_probability: float | None
    rate: RateRecord | None
    covariance_deg2_s2: list[list[float]] | None
    file: NotRequired[str]


class StarRateSequencer:
    """Measures the rate between successive images. ``interval_s``: see :class:`ImageIntervals`. ``method``: matcher
    between frames. ``options``: changed constants of the chain far_mst. After an image without a rate, the next rate is
    measured relative to that image, without an expected rotation."""

    def __init__(
        self,
        profile: CameraProfile,
        interval_s: float | None = None,
        method: str = "auto",
        options: Mapping[str, str] | None = None,
    ) -> None:
        self._profile, self._intervals, self._method = profile, ImageIntervals(interval_s), method
        self._options = options or {}
        self._before: tuple[Centroids, datetime | None] | None = None
        self._rate: Rate | None = None

    def measure(
        self, picture: NDArray[Any], taken_at: datetime | None = None, exposure_s: float | None = None
    ) -> StarRateRecord:
        """Return the rate since the previous image. Raises BadInput if the image does not fit the camera or the interval is
        unknown."""
        camera = self._profile.camera
        pixels, _ = self._profile.sensor.dark_columns.split(picture, camera.columns)
        if pixels.shape != (camera.rows, camera.columns):
            raise BadInput(
                "frame does not fit the camera",
                expected=f"{camera.rows} rows x {camera.columns} columns",
                got=" x ".join(map(str, pixels.shape)),
            )
        parameters = with_options(default_parameters(self._profile, exposure_s), self._options)
        stars = find_centroids(pixels, parameters).centroids
        before, self._before = self._before, (stars, taken_at)
        if before is None:
            return _record(stars, None, "first image of the sequence")
        measured = rate_from_stars(
            before[0], stars, camera, parameters, self._interval(before[1], taken_at), self._used_method(), self._rate
        )
        self._rate = measured.rate
        return _record(stars, measured, measured.reason)

    def _used_method(self) -> str:
        """Return the matcher. The rate match needs the rate of the previous interval; without one, the matcher is selected by
        the number of stars."""
        return "auto" if self._method == "rate" and self._rate is None else self._method

    def _interval(self, earlier: datetime | None, later: datetime | None) -> float:
        interval_s = self._intervals.between(earlier, later)
        if interval_s is None or interval_s <= 0:
            got = "none" if interval_s is None else f"{interval_s:g} s"
            raise BadInput("the time between two images is unknown", expected="above 0 s", got=got, hint="state it")
        return interval_s


def _record(stars: Centroids, measured: StarRate | None, reason: str) -> StarRateRecord:
    rate = None if measured is None else measured.rate
    bound = math.nan if measured is None else measured.relative.false_match_probability
    return {
        "stars": len(stars),
        "matched": 0 if measured is None else len(measured.relative.pairs),
        "method": "" if measured is None else measured.relative.method,
        "reason": reason,
        "false_match_probability": bound if math.isfinite(bound) else None,
        "rate": None if rate is None else rate_record(rate),
        "covariance_deg2_s2": None if rate is None else (np.degrees(np.degrees(rate.covariance_rad2_s2))).tolist(),
    }
