"""Time series of attitudes and the rotations between them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gss.domain.angles import Array
from gss.domain.errors import BadInput
from gss.domain.results import SolveResult
from gss.pipeline.calibration.advice import Advice

FEWEST = 5
GAP_TIMES = 3.0
"""Multiple of the median time step above which a step is a gap."""
POOR_SHARE = 0.8


@dataclass(frozen=True)
class AttitudeSeries:
    """Attitudes of n frames in order of time. ``quaternion`` (n, 4): cam_from_icrs, a row of NaN for a frame without an
    attitude; ``covariance_rad2`` (n, 3, 3) in camera axes, NaN if the chain does not provide it; ``centroids``,
    ``matches`` (n,) counts; ``residual_px`` (n,) rms, NaN if unknown."""

    times_s: Array
    quaternion: Array
    covariance_rad2: Array
    centroids: NDArray[np.intp]
    matches: NDArray[np.intp]
    residual_px: Array

    def __post_init__(self) -> None:
        n = len(self.times_s)
        shapes = {
            "quaternion": (n, 4),
            "covariance_rad2": (n, 3, 3),
            "centroids": (n,),
            "matches": (n,),
            "residual_px": (n,),
        }
        for name, shape in shapes.items():
            if getattr(self, name).shape != shape:
                raise BadInput(f"{name} has the wrong shape", expected=str(shape), got=str(getattr(self, name).shape))

    def __len__(self) -> int:
        return len(self.times_s)

    @property
    def solved(self) -> NDArray[np.bool_]:
        """Return an (n,) mask, True for frames with an attitude."""
        return np.asarray(np.isfinite(self.quaternion).all(axis=1))

    def only(self, index: NDArray[np.bool_] | NDArray[np.intp]) -> AttitudeSeries:
        """Return the series of the frames selected by a mask or an index array."""
        return AttitudeSeries(*(getattr(self, name)[index] for name in self.__dataclass_fields__))


def series_of(times_s: Sequence[float], results: Sequence[SolveResult | None]) -> AttitudeSeries:
    """Build a series from results in any order. A result is None if the frame could not be processed."""
    n = len(results)
    quaternion, covariance = np.full((n, 4), np.nan), np.full((n, 3, 3), np.nan)
    centroids, matches, residual = np.zeros(n, np.intp), np.zeros(n, np.intp), np.full(n, np.nan)
    for k, result in enumerate(results):
        if result is None:
            continue
        centroids[k] = len(result.centroids)
        matches[k] = 0 if result.matches is None else len(result.matches)
        residual[k] = result.residual_rms_px
        if result.attitude is not None:
            quaternion[k], covariance[k] = result.attitude.quaternion, result.attitude.covariance_rad2
    order = np.argsort(np.asarray(times_s, float), kind="stable")
    times = np.asarray(times_s, float)[order]
    return AttitudeSeries(
        times, quaternion[order], covariance[order], centroids[order], matches[order], residual[order]
    )


def usable(series: AttitudeSeries, quantity: str) -> AttitudeSeries:
    """Return the solved frames. Raises BadInput if there are too few or their times are not ascending."""
    good = series.only(series.solved)
    if len(good) < FEWEST:
        raise BadInput(
            f"too few attitudes for {quantity}",
            expected=f"{FEWEST} solved frames",
            got=f"{len(good)} of {len(series)}",
            hint="use consecutive star frames of one night",
        )
    if not (np.diff(good.times_s) > 0).all():
        raise BadInput(
            "frames with the same time",
            expected="times that increase from frame to frame",
            got=f"{int(np.count_nonzero(np.diff(good.times_s) <= 0))} steps without an increase",
            hint="imported files without a time are dated by their import; add the time to the files",
        )
    return good


def check_series(series: AttitudeSeries) -> tuple[Advice, ...]:
    """Return warnings about the run: gaps, and too many frames without an attitude."""
    advice: list[Advice] = []
    steps = np.diff(series.times_s)
    usual = float(np.median(steps)) if len(steps) else 0.0
    gaps = int(np.count_nonzero(steps > GAP_TIMES * usual)) if usual > 0 else 0
    if gaps:
        text = f"gaps longer than {GAP_TIMES * usual:.3g} s between frames: {gaps}"
        advice.append(Advice("gaps", text, "the figures apply only to the recorded frames"))
    share = float(series.solved.mean()) if len(series) else 0.0
    if share < POOR_SHARE:
        hint = "check the unsolved frames for clouds, a wrong camera or a short exposure"
        advice.append(Advice("unsolved", f"only {100 * share:.0f} % of the frames have an attitude", hint, share < 0.5))
    return tuple(advice)
