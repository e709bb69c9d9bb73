"""Reruns of a document's tables: published values next to the values computed by GSS."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import sqrt

from gss.domain.stars import StarTable

Cell = str | float | int | None
Progress = Callable[[float], None]
"""Called with the completed fraction. It can raise an exception to cancel the run."""


@dataclass(frozen=True)
class Curve:
    """A curve to plot: ``x`` and ``y`` of equal length, with their labels (unit included)."""

    title: str
    x_label: str
    y_label: str
    x: tuple[float, ...]
    y: tuple[float, ...]


@dataclass(frozen=True)
class Experiment:
    """One rerun of a document's table.

    ``columns``: names of the cells of each row. By convention they are the quantity, the published value, the value computed
    by GSS, and an explanation of the difference. ``conditions``: sentences that describe the conditions of the run.
    ``seed``: seed of all random numbers.
    """

    name: str
    title: str
    source: str
    columns: tuple[str, ...]
    rows: tuple[tuple[Cell, ...], ...]
    conditions: tuple[str, ...]
    seed: int
    notes: tuple[str, ...] = ()
    series: tuple[Curve, ...] = ()


def share_interval(hits: int, trials: int, z: float = 1.96) -> tuple[float, float]:
    """Return the Wilson confidence interval of a proportion, 95 % by default. Return (0, 1) without trials."""
    if trials == 0:
        return 0.0, 1.0
    p, n = hits / trials, trials
    centre, half = p + z * z / (2 * n), z * sqrt(p * (1 - p) / n + z * z / (4 * n * n))
    return max(0.0, (centre - half) / (1 + z * z / n)), min(1.0, (centre + half) / (1 + z * z / n))


def share_text(hits: int, trials: int) -> str:
    """Format a proportion with its interval: "97.0 % (95.1–98.2, n 300)"."""
    low, high = share_interval(hits, trials)
    return f"{100 * hits / max(1, trials):.1f} % ({100 * low:.1f}–{100 * high:.1f}, n {trials})"


@dataclass(frozen=True)
class ExperimentEntry:
    """An experiment that can be run. ``rerun``: function with the arguments stars, number of trials, seed and progress
    callback. ``trials``: default number of trials. ``epoch_jyear``: epoch of the star positions, Julian years."""

    name: str
    title: str
    rerun: Callable[[StarTable, int, int, Progress], Experiment]
    trials: int
    epoch_jyear: float = 2000.0
