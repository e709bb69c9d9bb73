"""Metrics of a server, read with the parser of Prometheus."""

from __future__ import annotations

from prometheus_client.parser import text_string_to_metric_families

from gss.operations.metrics import Metrics, MetricSample


def _queue(name: str, depth: float) -> list[MetricSample]:
    return [MetricSample("gss_queue_depth", "Queued items.", "gauge", depth, (("queue", name),))]


def test_sources_share_a_metric_and_a_failing_source_is_counted():
    """Two sources contribute to one metric, which is declared once. A failing third source is counted and hides no values."""

    def broken() -> list[MetricSample]:
        raise OSError("no such file")

    text = Metrics([lambda: _queue("solve", 2), broken, lambda: _queue('a "b"\n', 0.5)]).text()
    families = {family.name: family for family in text_string_to_metric_families(text)}
    depths = {sample.labels["queue"]: sample.value for sample in families["gss_queue_depth"].samples}
    assert depths == {"solve": 2.0, 'a "b"\n': 0.5}
    assert text.count("# TYPE gss_queue_depth gauge") == 1
    assert families["gss_metrics_failed"].samples[0].value == 1


def test_two_servers_in_one_process_count_separately():
    """Two instances have separate registries."""
    first, second = Metrics([]), Metrics([])
    first.count_request("frames", "2xx")
    first.observe_response("frames", 0.02)
    assert 'gss_http_requests_total{route="frames",status="2xx"} 1.0' in first.text()
    assert 'gss_http_seconds_bucket{le="0.025",route="frames"} 1.0' in first.text()
    assert 'route="frames"' not in second.text()
