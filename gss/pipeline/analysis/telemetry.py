"""Performance computed from the attitudes in telemetry, without frames or stars, for any smooth motion. Each attitude
is compared with the midpoint of its two neighbours. For a constant rotation the difference is zero, and for white noise
of σ it is σ·√1.5. Therefore the noise can be measured on a moving satellite, unless the satellite vibrates.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gss.domain.angles import Array
from gss.domain.rotation import turn_between, turned
from gss.pipeline.analysis.series import AttitudeSeries, check_series, usable
from gss.pipeline.calibration.advice import Advice
from gss.pipeline.calibration.robust import robust_sigma

UNEVEN = 0.02
MIDDLE_VARIANCE = 1.5


@dataclass(frozen=True)
class TelemetryFigures:
    """Performance figures from telemetry. ``noise_rad`` (3,): robust σ of one attitude per camera axis; ``claimed_rad``
    (3,): rms of the reported σ, NaN if it is not reported. ``deviation_rad`` (m, 3): differences from the midpoints of
    the neighbours at the times ``times_s`` (m,). ``rate_rad_s`` (m,) angular speed. ``availability``: share of frames
    with an attitude; ``longest_outage_s``; ``mean_matches``."""

    noise_rad: Array
    claimed_rad: Array
    times_s: Array
    deviation_rad: Array
    rate_rad_s: Array
    availability: float
    longest_outage_s: float
    mean_matches: float
    triples: int
    warnings: tuple[Advice, ...]


def telemetry_statistics(series: AttitudeSeries) -> TelemetryFigures:
    """Compute the figures from consecutive attitudes. Raises BadInput with fewer than five. The noise is NaN, with the
    severe warning ``few``, if fewer than three times three attitudes are equally spaced."""
    good = usable(series, "statistics")
    steps = np.diff(good.times_s)
    usual = float(np.median(steps))
    even = np.abs(steps - usual) <= UNEVEN * usual
    middle_index = np.flatnonzero(even[:-1] & even[1:]) + 1
    q = good.quaternion
    across = turn_between(q[middle_index - 1], q[middle_index + 1])
    middle = turned(q[middle_index - 1], across / 2)
    deviation = turn_between(middle, q[middle_index])
    factor = np.sqrt(MIDDLE_VARIANCE)
    noise = np.array([robust_sigma(deviation[:, k]) / factor if len(middle_index) > 2 else np.nan for k in range(3)])
    advice = list(check_series(series))
    if len(middle_index) < 10:
        text = f"only {len(middle_index)} times three attitudes follow each other evenly"
        advice.append(Advice("few", text, "use a longer run, or telemetry at a constant rate", len(middle_index) < 3))
    plain = np.sqrt(np.mean(deviation**2, axis=0)) / factor if len(middle_index) else np.full(3, np.nan)
    if len(middle_index) >= 10 and (plain > 2 * noise).any():
        advice.append(
            Advice(
                "shaking", "some attitudes differ strongly from their neighbours", "check for jitter or wrong attitudes"
            )
        )
    claimed = np.sqrt(np.mean(np.diagonal(good.covariance_rad2, axis1=1, axis2=2), axis=0))
    outage = float(np.diff(good.times_s).max())
    return TelemetryFigures(
        noise,
        claimed,
        good.times_s[middle_index],
        deviation,
        np.linalg.norm(across, axis=1)
        / np.maximum(good.times_s[middle_index + 1] - good.times_s[middle_index - 1], 1e-9),
        len(good) / len(series),
        outage if outage > 1.5 * usual else 0.0,
        float(good.matches.mean()),
        len(middle_index),
        tuple(advice),
    )
