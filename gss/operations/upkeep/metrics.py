"""Metrics in Prometheus' text format: those counted here, and those read from the services at each request.

Names follow the conventions: base units, ``_total`` for counters, labels with few values.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass

BUCKETS_S = (0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 2.5, 5.0, 10.0)
Labels = tuple[tuple[str, str], ...]


@dataclass(frozen=True)
class Sample:
    """One value. ``kind``: gauge or counter."""

    name: str
    help: str
    kind: str
    value: float
    labels: Labels = ()


@dataclass
class _Spread:
    """Histogram of durations."""

    counts: list[int]
    total: float = 0.0
    number: int = 0


class Metrics:
    """Counts, and collects the samples of ``sources`` at each request; a source that fails is omitted and counted."""

    def __init__(self, sources: Sequence[Callable[[], Iterable[Sample]]]) -> None:
        self._sources = tuple(sources)
        self._lock = threading.Lock()
        self._counts: dict[tuple[str, Labels], float] = {}
        self._spreads: dict[tuple[str, Labels], _Spread] = {}
        self._help: dict[str, str] = {}

    def count(self, name: str, text: str, by: float = 1.0, **labels: str) -> None:
        """Increase a counter."""
        with self._lock:
            key = (name, tuple(sorted(labels.items())))
            self._help[name] = text
            self._counts[key] = self._counts.get(key, 0.0) + by

    def observe(self, name: str, text: str, seconds: float, **labels: str) -> None:
        """Add a duration to a histogram."""
        with self._lock:
            key = (name, tuple(sorted(labels.items())))
            self._help[name] = text
            spread = self._spreads.setdefault(key, _Spread([0] * len(BUCKETS_S)))
            for k, limit in enumerate(BUCKETS_S):
                spread.counts[k] += seconds <= limit
            spread.total, spread.number = spread.total + seconds, spread.number + 1

    def text(self) -> str:
        """Return all metrics in Prometheus' text format 0.0.4."""
        return "".join(self._lines())

    def _lines(self) -> Iterator[str]:
        samples, failed = [], 0
        for ask in self._sources:
            try:
                samples += list(ask())
            except Exception:  # a defect of one source must not hide the metrics of the others
                failed += 1
        samples.append(Sample("gss_metrics_failed", "Rooms whose figures could not be read.", "gauge", failed))
        with self._lock:
            samples += [Sample(n, self._help[n], "counter", v, labels) for (n, labels), v in self._counts.items()]
            spreads = sorted(self._spreads.items())
            helps = dict(self._help)
        last = ""
        for sample in sorted(samples, key=lambda s: (s.name, s.labels)):
            if sample.name != last:
                last = sample.name
                yield f"# HELP {last} {_escaped(sample.help)}\n# TYPE {last} {sample.kind}\n"
            yield f"{last}{_labels(sample.labels)} {_number(sample.value)}\n"
        for (name, labels), spread in spreads:
            if name != last:
                last = name
                yield f"# HELP {name} {_escaped(helps[name])}\n# TYPE {name} histogram\n"
            for limit, number in zip((*BUCKETS_S, float("inf")), (*spread.counts, spread.number), strict=True):
                yield f"{name}_bucket{_labels((*labels, ('le', _number(limit))))} {number}\n"
            yield f"{name}_sum{_labels(labels)} {_number(spread.total)}\n"
            yield f"{name}_count{_labels(labels)} {spread.number}\n"


def _labels(labels: Labels) -> str:
    if not labels:
        return ""
    words = ",".join(f'{name}="{_escaped(value, quote=True)}"' for name, value in labels)
    return "{" + words + "}"


def _escaped(text: str, *, quote: bool = False) -> str:
    safe = text.replace("\\", "\\\\").replace("\n", "\\n")
    return safe.replace('"', '\\"') if quote else safe


def _number(value: float) -> str:
    if value == float("inf"):
        return "+Inf"
    return str(int(value)) if float(value).is_integer() and abs(value) < 1e15 else repr(float(value))
