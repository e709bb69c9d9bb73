"""A device with another dictionary is detected, blocked, and commanded only after a user's acknowledgement."""

from __future__ import annotations

import dataclasses
import time

import pytest
from fastapi.testclient import TestClient

from gss.api.app import create_app
from gss.instruments.dictionary.read_dictionary import load_dictionary
from gss.instruments.registry import Registry
from gss.settings import Settings
from gss.wiring.build import build

pytestmark = pytest.mark.timeout(120)


def test_commanding_is_blocked_until_the_difference_is_acknowledged(simulator, tmp_path, monkeypatch, signed_in):
    """The header shows the difference, commands are rejected with a message, ABORT is not; after acknowledgement commands
    are sent."""
    ours, shipped = load_dictionary(), Registry.get
    other = dataclasses.replace(ours, hash=bytes(32), same_layout_as=frozenset())
    monkeypatch.setattr(Registry, "get", lambda self, name: dataclasses.replace(shipped(self, name), dictionary=other))
    settings = Settings(data=tmp_path / "data", device=simulator)
    headers = signed_in(settings)
    with TestClient(create_app(build(settings)), base_url="http://localhost", headers=headers) as client:

        def link():
            return client.get("/api/link").json()

        for _ in range(600):
            if link()["dictionary_match"] is not None:
                break
            time.sleep(0.05)
        state = link()
        assert (state["dictionary_match"], state["dictionary_acknowledged"]) == (False, False)
        assert state["device_dictionary_hash"] == ours.hash_hex
        assert [alarm for alarm in state["alarms"] if "Dictionary differs" in alarm["text"]]
        refused = client.post("/api/commands", json={"name": "GET_STATUS"})
        assert (refused.status_code, "acknowledge" in refused.json()["hint"]) == (409, True)
        assert client.post("/api/commands/abort").status_code == 201

        assert client.post("/api/link/acknowledge-dictionary").json()["dictionary_acknowledged"] is True
        row = client.post("/api/commands", json={"name": "GET_STATUS"}).json()
        for _ in range(200):
            result = client.get(f"/api/commands/{row['id']}").json()["result"]
            if result == "completed":
                break
            time.sleep(0.05)
        assert result == "completed"
