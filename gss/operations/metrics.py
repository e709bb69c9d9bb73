"""Metrics for Prometheus: request counters, and values read from the services at each scrape.

Names follow the Prometheus conventions: base units, ``_total`` for counters, labels with few values.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass

from prometheus_client import CONTENT_TYPE_PLAIN_0_0_4, CollectorRegistry, Counter, Histogram, Metric, generate_latest
from prometheus_client.registry import Collector

CONTENT_TYPE = CONTENT_TYPE_PLAIN_0_0_4
BUCKETS_S = (0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 2.5, 5.0, 10.0)
Labels = tuple[tuple[str, str], ...]


@dataclass(frozen=True)
class MetricSample:
    """One value of a metric. ``kind``: gauge or counter."""

    name: str
    help: str
    kind: str
    value: float
    labels: Labels = ()


@dataclass
class StreamCounts:
    """Counts of event streams over HTTP. ``clients``: streams that are open now. ``refused``: streams rejected since the
    server started. ``dropped``: messages dropped because of slow clients since the server started."""

    clients: int = 0
    refused: int = 0
    dropped: int = 0


Source = Callable[[], Iterable[MetricSample]]


class Metrics:
    """The metrics of one server instance. ``sources``: functions called at each scrape."""

    def __init__(self, sources: Sequence[Source]) -> None:
        self._registry = CollectorRegistry()
        self._requests = Counter(
            "gss_http_requests", "Answered requests.", ("route", "status"), registry=self._registry
        )
        self._seconds = Histogram(
            "gss_http_seconds",
            "Time to the answer's first byte.",
            ("route",),
            buckets=BUCKETS_S,
            registry=self._registry,
        )
        self._registry.register(_Sources(sources))

    def count_request(self, route: str, status: str) -> None:
        """Count an answered request. ``status``: class of the status code, for example 2xx."""
        self._requests.labels(route, status).inc()

    def observe_response(self, route: str, seconds: float) -> None:
        """Add the time to the first byte of a response."""
        self._seconds.labels(route).observe(seconds)

    def text(self) -> str:
        """Return all metrics as text of type ``CONTENT_TYPE``."""
        return generate_latest(self._registry).decode()


class _Sources(Collector):
    """Collector that reads all sources. Several sources can add samples to one metric. A source that raises an
    exception is omitted and counted."""

    def __init__(self, sources: Sequence[Source]) -> None:
        self._sources = tuple(sources)

    def collect(self) -> Iterator[Metric]:
        """Yield the metrics of all sources."""
        metrics: dict[str, Metric] = {}
        failed = 0
        for source in self._sources:
            try:
                samples = list(source())
            except Exception:  # a defect of one source must not hide the metrics of the others
                failed += 1
                continue
            for sample in samples:
                metric = metrics.setdefault(sample.name, _metric(sample))
                metric.add_sample(sample.name, dict(sample.labels), sample.value)
        yield from metrics.values()
        failures = Metric("gss_metrics_failed", "Sources whose metrics could not be read.", "gauge")
        failures.add_sample(failures.name, {}, failed)
        yield failures


def _metric(sample: MetricSample) -> Metric:
    return Metric(sample.name.removesuffix("_total"), sample.help, sample.kind)
