"""Noise equivalent angle as a function of the integration time. The noise decreases with more light until another error
dominates (Moniteq 1983 §4.4)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from gss.domain.angles import Array
from gss.domain.errors import BadInput, GssError
from gss.pipeline.analysis.series import AttitudeSeries
from gss.pipeline.analysis.steady import earth_fixed
from gss.pipeline.calibration.advice import Advice

MIN_TIMES = 2


@dataclass(frozen=True)
class NeaCurve:
    """Noise for k ascending integration times ``exposure_s`` (k,). ``across_rad``, ``about_rad`` (k,): frame-to-frame
    noise across and about the boresight; ``relative_sigma`` (k,): relative σ of the noise; ``frames``: number of
    frames; ``matches``: mean number of matches. ``exponent`` ± ``exponent_sigma``: exponent e of across ∝ tᵉ. It is
    −0.5 if photon noise dominates, −1 if read-out noise dominates, and 0 if neither dominates."""

    exposure_s: Array
    across_rad: Array
    about_rad: Array
    relative_sigma: Array
    frames: Array
    matches: Array
    exponent: float
    exponent_sigma: float
    warnings: tuple[Advice, ...]


def noise_equivalent_angle(runs: Mapping[float, AttitudeSeries]) -> NeaCurve:
    """Compute the curve from runs of an Earth-fixed camera, keyed by exposure time in seconds. Runs that cannot be analysed are
    omitted with a warning. Raises BadInput with fewer than two usable times."""
    rows: list[tuple[float, float, float, float, int, float]] = []
    advice: list[Advice] = []
    for exposure_s in sorted(runs):
        series = runs[exposure_s]
        try:
            test = earth_fixed(series)
        except GssError as error:
            advice.append(
                Advice("short-run", f"{exposure_s:g} s was excluded: {error}", "take more frames with this exposure")
            )
            continue
        across = float(np.hypot(test.body[0].noise_rad, test.body[1].noise_rad) / np.sqrt(2))
        steps = max(1, test.solved - 1)
        matches = float(series.matches[series.solved].mean())
        rows.append((exposure_s, across, test.body[2].noise_rad, _relative_sigma(steps), test.solved, matches))
    if len(rows) < MIN_TIMES:
        raise BadInput(
            "too few integration times for a curve",
            expected=f"{MIN_TIMES} times with five solved frames each",
            got=f"{len(rows)}",
            hint="take about twenty frames at each of several exposures",
        )
    table = np.array(rows, float)
    x, y, weight = np.log(table[:, 0]), np.log(table[:, 1]), 1 / table[:, 3]
    design = np.column_stack([np.ones(len(x)), x]) * weight[:, None]
    covariance = np.linalg.inv(design.T @ design)
    fit = covariance @ design.T @ (y * weight)
    return NeaCurve(
        table[:, 0],
        table[:, 1],
        table[:, 2],
        table[:, 3],
        table[:, 4],
        table[:, 5],
        float(fit[1]),
        float(np.sqrt(covariance[1, 1])),
        tuple(advice),
    )


def _relative_sigma(steps: int) -> float:
    """Return the relative σ of the rms of this number of differences between consecutive frames on two axes.

    Consecutive differences share a frame, so the squares of normally distributed differences have the correlation 1/4.
    The variance of their mean is therefore 1 + 2/4 times that of independent differences.
    """
    return float(np.sqrt(1.5 / (4 * steps)))
