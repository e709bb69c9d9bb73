"""Rows of a performance sheet, and the confidence intervals of their figures."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gss.domain.angles import Array
from gss.domain.experiment import share_interval

AXES = ("x", "y", "z")
"""Camera axes: x and y across the boresight, z about it."""
CONFIDENCE = 0.95
REPLICATES = 300


@dataclass(frozen=True)
class SheetFigure:
    """Number with its 95 % interval. ``unit``: rad, rad/K, rad/d, rad/s, s, px, share, rad/s², e/s, mag or 1. The report
    converts these units for users."""

    name: str
    value: float
    low: float
    high: float
    unit: str


@dataclass(frozen=True)
class SheetRow:
    """Row of the sheet. ``conditions``: conditions under which the figures are valid. ``frames``: number of frames
    used. ``needs``: data that are missing if the row has no figures."""

    key: str
    title: str
    method: str
    conditions: str = ""
    frames: int = 0
    figures: tuple[SheetFigure, ...] = ()
    needs: str = ""

    @property
    def measured(self) -> bool:
        """True if the row has figures."""
        return bool(self.figures)

    def figure(self, name: str) -> SheetFigure:
        """Return the figure with that name. Raises KeyError."""
        for figure in self.figures:
            if figure.name == name:
                return figure
        raise KeyError(name)


def axis_rows(values: Array, low: Array, high: Array, unit: str, prefix: str = "") -> tuple[SheetFigure, ...]:
    """Return one figure per camera axis, from (3,) values and interval bounds."""
    return tuple(
        SheetFigure(f"{prefix}{axis}", float(v), float(a), float(b), unit)
        for axis, v, a, b in zip(AXES, values, low, high, strict=True)
    )


def share_figure(name: str, hits: int, trials: int) -> SheetFigure:
    """Return a proportion with its Wilson interval."""
    low, high = share_interval(hits, trials)
    return SheetFigure(name, hits / trials, low, high, "share")


def draws(blocks: NDArray[np.intp], rng: np.random.Generator) -> Array:
    """Return (REPLICATES, n) numbers of occurrences of each item in each bootstrap sample. ``blocks`` (n,): label of
    each item. Items with equal labels are drawn together, because their errors are correlated."""
    labels, block_of = np.unique(blocks, return_inverse=True)
    count = len(labels)
    return np.asarray(rng.multinomial(count, np.full(count, 1 / count), REPLICATES)[:, block_of], float)


def resampled(
    blocks: NDArray[np.intp], statistic: Callable[[NDArray[np.intp]], Array], rng: np.random.Generator
) -> Array:
    """Return the (REPLICATES, …) values of a statistic of bootstrap samples. ``statistic`` receives the indices of the
    items, with repetitions."""
    items = np.arange(len(blocks), dtype=np.intp)
    return np.array([statistic(np.repeat(items, times.astype(np.intp))) for times in draws(blocks, rng)])


def interval(replicates: Array) -> tuple[Array, Array]:
    """Return the 95 % percentile interval over the first axis."""
    low, high = np.nanpercentile(replicates, [100 * (1 - CONFIDENCE) / 2, 100 * (1 + CONFIDENCE) / 2], axis=0)
    return np.asarray(low), np.asarray(high)


def consecutive_blocks(count: int, length: int) -> NDArray[np.intp]:
    """Return (count,) labels of blocks of ``length`` consecutive items."""
    return np.arange(count, dtype=np.intp) // max(1, length)


def missing(key: str, title: str, method: str, needs: str) -> SheetRow:
    """Return a row that was not measured."""
    return SheetRow(key, title, method, needs=needs)


def counted_conditions(parts: Sequence[str]) -> str:
    """Join the non-empty conditions to one text."""
    return "; ".join(p for p in parts if p)
