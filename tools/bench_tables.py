"""Benchmark tables: results with their conditions, as text, Markdown or plain values for JSON."""

from __future__ import annotations

import importlib.metadata
import os
import platform
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from time import process_time
from typing import Any, TypeVar

import numpy as np

T = TypeVar("T")
Value = float | int | str | None


@dataclass(frozen=True)
class BenchTable:
    """Results measured under the same conditions. ``rows``: label and values of each measurement; column names contain
    the units. ``skipped``: texts that state which measurement was skipped and why."""

    section: str
    title: str
    conditions: str
    seed: int
    rows: list[tuple[str, dict[str, Value]]]
    skipped: list[str] = field(default_factory=list)

    @property
    def columns(self) -> list[str]:
        """Names of all values, in order of appearance."""
        return list(dict.fromkeys(name for _, values in self.rows for name in values))

    def plain(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        return {
            "section": self.section,
            "title": self.title,
            "conditions": self.conditions,
            "seed": self.seed,
            "rows": [{"what": label, **values} for label, values in self.rows],
            "skipped": self.skipped,
        }

    def cells(self) -> list[list[str]]:
        """Return header and rows as text."""
        body = [[label, *(_text(values.get(name)) for name in self.columns)] for label, values in self.rows]
        return [["", *self.columns], *body]

    def text(self) -> str:
        """Return the table for the terminal."""
        cells = self.cells()
        widths = [max(len(row[i]) for row in cells) for i in range(len(cells[0]))]
        lines = [
            "  ".join([row[0].ljust(widths[0]), *(c.rjust(w) for c, w in zip(row[1:], widths[1:], strict=True))])
            for row in cells
        ]
        return "\n".join([f"{self.title} (seed {self.seed})", self.conditions, *lines, *self._skipped_lines()]) + "\n"

    def markdown(self) -> str:
        """Return the table as Markdown."""
        cells = self.cells()
        lines = ["| " + " | ".join(row) + " |" for row in cells]
        lines.insert(1, "|---|" + "---:|" * len(self.columns))
        head = [f"## {self.title}", "", f"{self.conditions} Seed {self.seed}.", ""]
        return "\n".join([*head, *lines, *(f"\n{line}" for line in self._skipped_lines())]) + "\n"

    def _skipped_lines(self) -> list[str]:
        return [f"skipped: {line}" for line in self.skipped]


def _text(value: Value) -> str:
    if value is None:
        return "–"
    return value if isinstance(value, str) else f"{value:,}" if isinstance(value, int) else f"{value:.4g}"


def timed_ms(work: Callable[[], T]) -> tuple[float, T]:
    """Return the processor time of a call in ms, and its result. With one thread, processor time equals the duration on
    an idle machine, and other programs affect it less than the wall clock."""
    start_s = process_time()
    result = work()
    return 1e3 * (process_time() - start_s), result


def repeated_ms(work: Callable[[], object], times: int) -> list[float]:
    """Return the durations of repeated calls, after one warm-up call."""
    work()
    return [timed_ms(work)[0] for _ in range(times)]


def spread(durations_ms: Sequence[float]) -> dict[str, Value]:
    """Return median and 95th percentile of processor times."""
    return {
        "median_ms": float(np.median(durations_ms)),
        "p95_ms": float(np.percentile(durations_ms, 95)),
    }


def machine() -> dict[str, Any]:
    """Return the machine and the software versions of the measurement."""
    packages = ("numpy", "scipy", "numba", "sep", "tetra3rs", "cedar-solve")
    return {
        "processor": _processor(),
        "cores": os.cpu_count(),
        "system": platform.system(),
        "python": platform.python_version(),
        "packages": {name: _version(name) for name in packages},
        "load_average": [round(load, 2) for load in os.getloadavg()],
    }


def _processor() -> str:
    try:
        with open("/proc/cpuinfo") as file:
            names = [line.split(":", 1)[1].strip() for line in file if line.startswith("model name")]
    except OSError:
        names = []
    return names[0] if names else platform.machine()


def _version(package: str) -> str | None:
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return None
