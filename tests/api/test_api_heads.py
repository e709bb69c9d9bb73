"""Spacecraft with several heads over HTTP and in the shell: storage, display, changes, deletion and invalid input."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from fastapi.testclient import TestClient

from gss.cli import main
from gss.settings import Settings
from gss.wiring.build import build

PATH = "/api/fleet/spacecraft"
SAT: dict[str, Any] = {
    "name": "SAT",
    "heads": [
        {"unit": "A", "mounting_deg": [0.0, 0.0, 0.0]},
        {"unit": "B", "mounting_deg": [90.0, 0.0, 0.0], "sigma_arcsec": 20.0},
    ],
}


@pytest.fixture
def client(tmp_path: Path, client_of: Callable[..., TestClient]) -> Iterator[TestClient]:
    with client_of(build(Settings(data=tmp_path))) as client:
        yield client


def test_a_spacecraft_is_stored_and_its_unknown_state_is_shown(client: TestClient, tmp_path: Path, capsys: Any) -> None:
    """Without attitudes the state is ``unknown``. The shell shows and changes the same spacecraft."""
    assert client.get(PATH).json() == []
    reply = client.post(PATH, json=SAT)
    assert reply.status_code == 201, reply.text
    (shown,) = client.get(PATH).json()
    assert (shown["state"], shown["fused"], shown["pairs"], shown["alarms"]) == ("unknown", None, [], [])
    assert shown["heads"][1]["boresight"] == pytest.approx([0, -1, 0], abs=1e-9)
    assert shown["heads"][1]["problem"] == "this server has no such unit"
    history = client.get(f"{PATH}/{shown['id']}/history?hours=24")
    assert history.json() == {"points": []}
    assert main(["heads", "set", "SAT", "--head", "A=0,0,0", "--head", "B=80,0,10@5", "--data", str(tmp_path)]) == 0
    capsys.readouterr()
    assert main(["heads", "list", "--json", "--data", str(tmp_path)]) == 0
    (printed,) = json.loads(capsys.readouterr().out)
    assert printed["heads"][1]["mounting_deg"] == pytest.approx([80, 0, 10])
    assert client.get(PATH).json()[0]["heads"][1]["sigma_arcsec"] == pytest.approx(5)
    assert main(["heads", "list", "--data", str(tmp_path)]) == 0
    assert "No comparison is stored" in capsys.readouterr().out
    assert main(["heads", "set", "SAT", "--head", "A=0,0", "--data", str(tmp_path)]) == 2
    assert main(["heads", "remove", "SAT", "--data", str(tmp_path)]) == 0
    assert main(["heads", "remove", "SAT", "--data", str(tmp_path)]) == 2
    assert client.get(PATH).json() == []


def test_wrong_spacecraft_are_refused(client: TestClient) -> None:
    """Each invalid spacecraft is rejected, and a correction without a misalignment estimate is a conflict."""
    spacecraft = client.post(PATH, json=SAT).json()
    for body in (
        SAT,
        SAT | {"name": "Other"},
        SAT | {"heads": []},
        SAT | {"heads": [{"unit": "A"}]},
        SAT | {"source": "both"},
        SAT | {"tolerance_s": 0},
        SAT | {"more": 1},
    ):
        assert client.post(PATH, json=body).status_code in (409, 422), body
    assert client.put(f"{PATH}/{spacecraft['id'] + 1}", json=SAT).status_code == 404
    answer = client.post(f"{PATH}/{spacecraft['id']}/correct", json={"unit": "B"})
    assert answer.status_code == 409
    assert "misalignment estimate of this head" in answer.json()["message"]
    assert client.get(f"{PATH}/{spacecraft['id']}/history?hours=0").status_code == 422
    assert client.get(f"{PATH}/99/history").status_code == 404
    assert client.put(f"{PATH}/{spacecraft['id']}", json=SAT | {"stale_s": 60.0}).json()["stale_s"] == 60
    assert client.delete(f"{PATH}/{spacecraft['id']}").status_code == 204
    assert len(client.get(PATH).json()) == 0
