"""Histogram with a normal curve of the same mean and standard deviation, as in the documents' figures."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gss.domain.angles import Array


@dataclass(frozen=True)
class Histogram:
    """Histogram of values. ``edges`` (k + 1,), ``counts`` (k,); ``mean``, ``sigma``: of all values; ``label``: includes
    the unit."""

    label: str
    edges: Array
    counts: NDArray[np.intp]
    mean: float
    sigma: float

    @property
    def normal(self) -> Array:
        """Return the (k,) expected counts of a normal distribution with the same mean, standard deviation and area."""
        middle, width = (self.edges[1:] + self.edges[:-1]) / 2, np.diff(self.edges)
        if not self.sigma > 0:
            return np.zeros(len(middle))
        density = np.exp(-0.5 * ((middle - self.mean) / self.sigma) ** 2) / (self.sigma * np.sqrt(2 * np.pi))
        return np.asarray(density * width * self.counts.sum())


def histogram(values: Array, label: str, width: float | None = None, most_bins: int = 60) -> Histogram:
    """Build the histogram of the finite values with bins of ``width``. If None, the width is computed from the spread."""
    v = np.asarray(values, float)
    v = v[np.isfinite(v)]
    if not len(v):
        return Histogram(label, np.array([0.0, 1.0]), np.zeros(1, np.intp), float("nan"), float("nan"))
    low, high = float(v.min()), float(v.max())
    if width is None:
        spread = float(np.subtract(*np.percentile(v, [75, 25])))
        width = 2 * spread / len(v) ** (1 / 3) if spread > 0 else max(high - low, 1e-12)
    width = max(width, (high - low) / most_bins, 1e-300)
    start = np.floor(low / width) * width
    bins = max(1, int(np.ceil((high - start) / width + 1e-9)))
    counts, edges = np.histogram(v, bins=bins, range=(start, start + bins * width))
    sigma = float(v.std(ddof=1)) if len(v) > 1 else float("nan")
    return Histogram(label, edges, counts.astype(np.intp), float(v.mean()), sigma)
