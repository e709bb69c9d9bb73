"""Preview of a retention policy, confirmation of the clock, and unusual removals."""

from __future__ import annotations

from datetime import timedelta

from sqlalchemy import func, select

from gss.store.models import Event


def test_a_preview_counts_and_changes_nothing(client):
    """A preview counts the events that a policy would delete and changes neither the current policy nor the events."""
    before = client.get("/api/admin/retention").json()
    harmless = client.post("/api/admin/retention/preview", json={})
    assert harmless.status_code == 200, harmless.text
    assert {harmless.json()[name] for name in ("frames", "frames_bytes", "packets", "to_thin", "events")} == {0}
    assert harmless.json()["unusual"] == ""
    services = client.app.state.services
    services.base.bus.record("test", "ok", "a line to count")
    preview = client.post("/api/admin/retention/preview", json={"events_days": 1e-9, "keep_frames": 0}).json()
    assert preview["events"] >= 1
    assert client.get("/api/admin/retention").json()["events_days"] == before["events_days"] == 0
    assert any(row["text"] == "a line to count" for row in client.get("/api/events?after=0").json())


def test_an_invalid_policy_has_no_preview(client):
    """A policy that would delete packets before they are thinned is rejected."""
    wrong = client.post("/api/admin/retention/preview", json={"telemetry_days": 1, "telemetry_thin_days": 2})
    assert wrong.status_code == 400
    assert "thinned" in wrong.json()["message"]


def test_only_an_admin_confirms_the_clock(client, client_of):
    """While the clock is in doubt, the response states the reason and removals are rejected. Only an admin may
    confirm the clock; the confirmation is audited.
    """
    services = client.app.state.services
    now = services.base.trust.state().now
    services.base.trust._store_trusted(now - timedelta(days=3652), "test")
    clock = client.get("/api/admin/retention").json()["clock"]
    assert "3652 days ahead" in clock["doubt"]
    rejected = client.post("/api/admin/retention/run")
    assert (rejected.status_code, "clock is in doubt" in rejected.json()["message"]) == (409, True), rejected.text
    path, body = "/api/admin/retention/confirm-clock", {"seen": clock["now"]}
    for role in ("viewer", "operator", "engineer", "catalogue manager"):
        assert client_of(services, f"a {role}", role).post(path, json=body).status_code == 403
    assert client.post(path, json={"seen": "2036-01-01T00:00:00Z"}).status_code == 400
    assert client.get("/api/admin/retention").json()["clock"]["doubt"]
    assert client.post(path, json=body).json()["clock"]["doubt"] == ""
    rows = client.get("/api/audit?limit=20").json()
    assert any(
        row["who"] == "ann" and "3652 days ahead" in row["detail"] and row["result"] == "done" for row in rows
    ), rows


def test_an_unusual_removal_needs_the_confirmed_preview(client):
    """A removal of thousands of events is a 409 without the figures of its preview, and a job with them."""
    services = client.app.state.services
    old = services.base.trust.state().now - timedelta(days=40)
    with services.base.database.unit_of_work() as session:
        first = session.scalar(select(func.min(Event.seq)))
        session.add_all(
            Event(seq=first - k, at=old, kind="t", severity="ok", text="old", data={}) for k in range(1, 2101)
        )
    assert client.put("/api/admin/retention", json={"events_days": 30.0}).status_code == 200
    preview = client.post("/api/admin/retention/preview", json={"events_days": 30.0}).json()
    assert "2100 of" in preview["unusual"], preview
    rejected = client.post("/api/admin/retention/run")
    assert (rejected.status_code, "2100 of" in rejected.json()["got"]) == (409, True), rejected.text
    confirmed = {name: preview[name] for name in ("at", "frames", "frames_bytes", "packets", "to_thin", "events")}
    fewer = client.post("/api/admin/retention/run", json={"confirmed": confirmed | {"events": 2000}})
    assert (fewer.status_code, "More data would be removed" in fewer.json()["message"]) == (409, True), fewer.text
    job = client.post("/api/admin/retention/run", json={"confirmed": confirmed})
    assert job.status_code == 202, job.text
    services.base.jobs.finish()
    assert client.get(f"/api/jobs/{job.json()['id']}").json()["result"]["removed"]["events"] == 2100
