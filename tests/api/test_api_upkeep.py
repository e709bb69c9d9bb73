"""Health, metrics, retention, backups and the check of the store over HTTP."""

from __future__ import annotations

import io
import shutil
import tarfile
import time

import pytest
from prometheus_client.parser import text_string_to_metric_families


def wait_for_job(client, reply):
    """Wait for the end of the job that a response started and return the job."""
    assert reply.status_code == 202, reply.text
    for _ in range(1000):
        job = client.get(f"/api/jobs/{reply.json()['id']}").json()
        if job["state"] in ("done", "failed", "cancelled"):
            return job
        time.sleep(0.01)
    pytest.fail("the job did not end")


def test_health_lists_every_part_with_its_state(client):
    """Health lists every check with its state. A server without a backup is in the state ``watch``."""
    health = client.get("/api/admin/health").json()
    states = {check["name"]: check["state"] for check in health["checks"]}
    expected = [
        "database",
        "audit log",
        "disk",
        "blobs",
        "captures",
        "link",
        "jobs",
        "queues",
        "clock",
        "backup",
        "memory",
        "version",
    ]
    assert [name for name in expected if name not in states] == []
    assert (states["database"], states["disk"], states["backup"]) == ("ok", "ok", "watch")
    assert health["state"] == "watch"


def test_metrics_are_readable_by_prometheus_parser(client):
    """Every metric has a type and a help text. Request counters increase, and unknown addresses do not become
    labels.
    """
    for path in ("/api/frames", "/api/frames", "/api/dictionary", "/api/made-up", "/api/made-up-2"):
        client.get(path)
    reply = client.get("/metrics")
    assert reply.headers["content-type"].startswith("text/plain; version=0.0.4")
    families = {f.name: f for f in text_string_to_metric_families(reply.text)}
    names = "gss_link_bytes gss_link_errors gss_queue_depth gss_queue_dropped gss_stream_clients gss_disk_free_bytes gss_jobs"
    names += (
        " gss_database_bytes process_resident_memory_bytes gss_uptime_seconds gss_http_seconds gss_capture_lost_bytes"
    )
    assert [name for name in names.split() if name not in families and name != "gss_jobs"] == []
    assert {f.type for f in families.values()} <= {"gauge", "counter", "histogram"}
    assert all(f.documentation for f in families.values())
    counted = {(s.labels["route"], s.labels["status"]): s.value for s in families["gss_http_requests"].samples}
    assert counted["frames", "2xx"] >= 2
    assert counted["dictionary", "2xx"] >= 1
    assert counted["other", "4xx"] >= 2
    assert not any("made-up" in route for route, _ in counted)
    assert families["gss_metrics_failed"].samples[0].value == 0


def test_retention_is_configured_and_forecast(client):
    """The default policy keeps all data. A changed policy is stored and run. Impossible values are rejected with a
    message.
    """
    first = client.get("/api/admin/retention").json()
    assert (first["frames_days"], first["telemetry_days"], first["last_run"]) == (0, 0, None)
    assert first["forecast"]["free_bytes"] > 0
    body = {"frames_days": 30.0, "telemetry_thin_days": 7.0, "telemetry_days": 90.0, "keep_frames": 10}
    assert client.put("/api/admin/retention", json=body).json()["frames_days"] == 30
    wrong = client.put("/api/admin/retention", json=body | {"telemetry_days": 5.0})
    assert (wrong.status_code, "thinned" in wrong.json()["message"]) == (400, True)
    assert wait_for_job(client, client.post("/api/admin/retention/run"))["state"] == "done"
    assert client.get("/api/admin/retention").json()["last_run"]


def test_a_backup_is_made_listed_and_downloaded(client):
    """The downloaded file is a tar archive with manifest, checksum and database. Unknown names are rejected."""
    job = wait_for_job(client, client.post("/api/admin/backups"))
    (backup,) = client.get("/api/admin/backups").json()
    assert (job["state"], job["result"]["name"], backup["kind"]) == ("done", backup["name"], "sqlite")
    reply = client.get(f"/api/admin/backups/{backup['name']}/file")
    with tarfile.open(fileobj=io.BytesIO(reply.content)) as tar:
        names = tar.getnames()
    assert {n.split("/")[-1] for n in names[:3]} == {"manifest.json", "manifest.sha256", "gss.db"}
    for name in ("../../etc/passwd", "2026-01-01T000000Z", "x"):
        assert client.get(f"/api/admin/backups/{name}/file").status_code in (400, 404)
    health = {check["name"]: check for check in client.get("/api/admin/health").json()["checks"]}
    assert health["backup"]["state"] == "ok"


def test_a_backup_needs_space_on_the_disk_of_the_backups(client, monkeypatch):
    """A backup is created if only the disk of the data is full. It is rejected if the disk of the backups is full, and health
    reports this disk.
    """
    folder = client.app.state.services.upkeep.backups.folder
    folder.mkdir(exist_ok=True)
    usage_of, full = shutil.disk_usage, []
    monkeypatch.setattr(shutil, "disk_usage", lambda path: usage_of(path)._replace(free=0 if path in full else 1 << 40))
    full[:] = [folder.parent]
    assert wait_for_job(client, client.post("/api/admin/backups"))["state"] == "done"
    full[:] = [folder]
    refused = client.post("/api/admin/backups")
    assert (refused.status_code, "disk of the backups is nearly full" in refused.json()["message"]) == (503, True)
    health = {check["name"]: check for check in client.get("/api/admin/health").json()["checks"]}
    assert (health["disk"]["state"], health["backup"]["state"]) == ("ok", "critical")
    assert "disk of the backups: 0 MB" in health["backup"]["text"]


def test_the_store_is_checked_as_a_job(client):
    """The result of the job is the report of the check, and the job can be started again."""
    job = wait_for_job(client, client.post("/api/admin/check-store"))
    assert (job["state"], job["result"]["whole"], job["can_start_again"]) == ("done", True, True)
    again = wait_for_job(client, client.post(f"/api/jobs/{job['id']}/again"))
    assert (again["state"], again["id"] > job["id"]) == ("done", True)
