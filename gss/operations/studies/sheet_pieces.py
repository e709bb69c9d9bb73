"""Common parts of analysis reports: tables of axes, plots over time, histograms."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from gss.domain.angles import ARCSEC_RAD, Array
from gss.operations.report.figures import number
from gss.operations.report.parts import Note, Plot, Series, Table
from gss.pipeline.analysis.steady import AxisFigures
from gss.pipeline.calibration.advice import Advice
from gss.pipeline.calibration.histogram import histogram

PHASES = 10
"""Number of bins within a pixel."""
MIN_IN_BIN = 5


def notes(warnings: Iterable[Advice]) -> list[Note]:
    """Convert warnings to notes of the report."""
    return [Note(w.text, w.hint, w.severe, w.code) for w in warnings]


def axes_table(axes: Sequence[AxisFigures], paper: dict[str, tuple[float, float]] | None = None) -> Table:
    """Return a table of values per axis in arcseconds. ``paper``: values of a paper for comparison, 1σ and 3σ in
    degrees."""
    column_titles = ["axis", "1σ ″", "95 %", "3σ ″", "frame to frame ″", "reported σ ″", "drift ″/s"]
    rows = []
    for axis in axes:
        sigma, low, high, noise, claimed, drift = (
            v / ARCSEC_RAD
            for v in (axis.sigma_rad, axis.low_rad, axis.high_rad, axis.noise_rad, axis.claimed_rad, axis.drift_rad_s)
        )
        row = [
            axis.name,
            number(sigma, 3),
            f"{number(low, 3)} – {number(high, 3)}",
            number(3 * sigma, 3),
            number(noise, 3),
            number(finite(claimed), 3),
            number(drift, 4),
        ]
        if paper is not None:
            one_sigma, three_sigma = paper[axis.name]
            row += [number(one_sigma * 3600, 3), number(three_sigma * 3600, 3)]
        rows.append(row)
    if paper is not None:
        column_titles += ["Erlank 2013 1σ ″", "3σ ″"]
    return Table("Axes", column_titles, rows)


def over_time(title: str, times_s: Array, values: Array, labels: Sequence[str], unit: str) -> Plot:
    """Plot (n, k) values against Unix seconds."""
    times = numbers(times_s)
    series = [Series(label, times, maybe(values[:, k]), "dots") for k, label in enumerate(labels)]
    return Plot(title, "UTC", unit, series, time=True)


def bars(name: str, values: Array) -> Plot:
    """Return a histogram of values with the normal distribution of the same mean and width."""
    binned = histogram(values, name)
    normal = maybe(binned.normal)
    middles = numbers((binned.edges[1:] + binned.edges[:-1]) / 2)
    return Plot(
        f"Deviation {name}",
        "arcsec",
        "frames",
        [
            Series("frames", numbers(binned.edges), maybe(binned.counts.astype(float)), "bars"),
            Series("normal", middles, normal),
        ],
    )


def phase_means(position_px: Array, error_px: Array) -> list[float | None]:
    """Return the mean error by position within a pixel; None for a bin with fewer than five stars."""
    within = position_px - error_px
    bin_of = np.clip(((within - np.round(within) + 0.5) * PHASES).astype(int), 0, PHASES - 1)
    return [
        float(error_px[bin_of == k].mean()) if np.count_nonzero(bin_of == k) >= MIN_IN_BIN else None
        for k in range(PHASES)
    ]


def rms(values: Sequence[float | None]) -> float | None:
    """Return the root mean square of the values that are not None; None if there are none."""
    numbers = [v for v in values if v is not None]
    return float(np.sqrt(np.mean(np.square(numbers)))) if numbers else None


def numbers(values: Array) -> list[float]:
    """Return the values as floats."""
    return [float(v) for v in values]


def maybe(values: Array) -> list[float | None]:
    """Return the values as floats; None for NaN and infinities."""
    return [float(v) if np.isfinite(v) else None for v in values]


def finite(value: float) -> float | None:
    """Return the number, or None for NaN and infinities."""
    return value if np.isfinite(value) else None
