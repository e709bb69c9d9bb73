"""Notifications over HTTP: targets without secrets, rules as text, test messages, and invalid files."""

from __future__ import annotations

import pytest

from gss.domain.errors import BadInput
from gss.settings import Settings
from gss.wiring.build import build

FILE = """
targets:
  - name: chat
    webhook: {url: "http://127.0.0.1:9/gss", secret_env: HOOK_SECRET}
rules:
  - {name: alarms, to: [chat], escalate: [{after_min: 10, to: [chat]}], quiet: {start: "22:00", end: "06:00"}}
"""


def test_an_admin_sees_targets_and_rules_and_sends_a_test(client_of, tmp_path, monkeypatch):
    """The response does not contain the secret. The test message is queued. Other roles are rejected."""
    monkeypatch.setenv("HOOK_SECRET", "do not show")
    (tmp_path / "rules.yaml").write_text(FILE)
    services = build(Settings(data=tmp_path, notifications=str(tmp_path / "rules.yaml")))
    http = client_of(services)
    listed = http.get("/api/notifications").json()
    assert listed["targets"] == [{"name": "chat", "kind": "webhook", "host": "127.0.0.1", "recipients": []}]
    assert "waits from 22:00 to 06:00 UTC below critical" in listed["rules"][0]["text"]
    sent = http.post("/api/notifications/test", json={"target": "chat"})
    assert (sent.status_code, sent.json()["state"]) == (202, "pending")
    assert http.post("/api/notifications/test", json={"target": "pager"}).status_code == 404
    assert "do not show" not in http.get("/api/notifications").text
    assert client_of(services, "bob", "operator").get("/api/notifications").status_code == 403


def test_a_server_does_not_start_with_an_invalid_file(tmp_path):
    """A missing secret prevents the start, because it would silence the notifications."""
    (tmp_path / "rules.yaml").write_text(FILE)
    with pytest.raises(BadInput, match="HOOK_SECRET is not set"):
        build(Settings(data=tmp_path, notifications=str(tmp_path / "rules.yaml")))
