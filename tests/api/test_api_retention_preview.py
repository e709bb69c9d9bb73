"""What a removal would take is told before anything is chosen."""

from __future__ import annotations


def test_a_preview_counts_and_changes_nothing(client):
    """With lines of the record a moment old allowed to go, they are counted; the policy in force stays, and so do the lines."""
    before = client.get("/api/admin/retention").json()
    harmless = client.post("/api/admin/retention/preview", json={})
    assert harmless.status_code == 200, harmless.text
    assert set(harmless.json().values()) == {0}
    app = client.app.state.services
    app.bus.record("test", "ok", "a line to count")
    told = client.post("/api/admin/retention/preview", json={"events_days": 1e-9, "keep_frames": 0}).json()
    assert told["events"] >= 1
    assert client.get("/api/admin/retention").json()["events_days"] == before["events_days"] == 0
    assert any(row["text"] == "a line to count" for row in client.get("/api/events?after=0").json())


def test_a_preview_refuses_what_could_not_be_chosen(client):
    """Packets that would go before they are thinned."""
    wrong = client.post("/api/admin/retention/preview", json={"telemetry_days": 1, "telemetry_thin_days": 2})
    assert wrong.status_code == 400
    assert "thinned" in wrong.json()["message"]
