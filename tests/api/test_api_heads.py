"""Spacecraft with several heads over HTTP and in the shell: storage, display, changes, deletion and invalid input."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fastapi.testclient import TestClient

from gss.cli import main
from gss.orbit.read_attitude import read_attitude_file
from gss.settings import Settings
from gss.store.models import FusedRow
from gss.wiring.build import build

T0 = datetime(2026, 12, 1, 18, 0, tzinfo=UTC)
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


def test_a_damaged_spacecraft_is_shown_with_the_reason(client: TestClient, tmp_path: Path, capsys: Any) -> None:
    """A damaged spacecraft is listed with the reason, also in the shell, and can be deleted."""
    spacecraft_id = client.post(PATH, json=SAT).json()["id"]
    client.post(PATH, json=SAT | {"name": "TWO", "heads": [{"unit": "C", "mounting_deg": [0.0, 0.0, 0.0]}]})
    with client.app.state.services.base.database.engine.begin() as connection:
        connection.exec_driver_sql("UPDATE spacecraft SET heads = '[{' WHERE id = ?", (spacecraft_id,))
    damaged, other = client.get(PATH).json()
    assert (damaged["name"], damaged["state"], damaged["heads"]) == ("SAT", "warning", [])
    assert "is damaged: heads" in damaged["text"]
    assert (other["name"], len(other["heads"])) == ("TWO", 1)
    assert main(["heads", "list", "--data", str(tmp_path)]) == 0
    assert "SAT: attitudes on board. The stored spacecraft is damaged" in capsys.readouterr().out
    assert client.delete(f"{PATH}/{spacecraft_id}").status_code == 204


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


def test_fused_attitudes_are_exported_as_ccsds_messages(client: TestClient, tmp_path: Path, capsys: Any) -> None:
    """AEM and ACM contain the stored attitudes of the body with their variances, over HTTP and in the shell."""
    spacecraft_id = client.post(PATH, json=SAT).json()["id"]
    quaternions = np.array([[0.0, 0.0, 0.0, 1.0], [0.6, 0.0, 0.0, 0.8]])
    variances = [4e-10, 9e-10, 16e-10]
    with client.app.state.services.base.database.unit_of_work() as session:
        for k, quaternion in enumerate(quaternions):
            row = FusedRow(spacecraft_id=spacecraft_id, at=T0 + timedelta(seconds=k), units=["A", "B"])
            row.quaternion = quaternion.tolist()
            row.covariance = [variances[0], 0.0, 0.0, variances[1], 0.0, variances[2]]
            session.add(row)
    span = {"start": T0.isoformat(), "end": (T0 + timedelta(minutes=1)).isoformat()}
    path = f"{PATH}/{spacecraft_id}/attitudes"
    for message_format in ("aem", "acm"):
        reply = client.get(path, params=span | {"format": message_format})
        assert reply.status_code == 200, reply.text
        history = read_attitude_file(reply.content)
        assert (history.object_name, history.frame) == ("SAT", "SC_BODY_1")
        assert history.quaternions == pytest.approx(quaternions, abs=1e-9)
        assert history.times_s == pytest.approx([T0.timestamp(), T0.timestamp() + 1])
    covariance = reply.text.partition("COV_TYPE = ANGLE\n")[2].splitlines()[0].split()
    assert [float(v) for v in covariance[1:]] == pytest.approx(np.degrees(np.sqrt(variances)) ** 2, rel=1e-5)
    words = ["--from", span["start"], "--to", span["end"], "--format", "acm", "--data", str(tmp_path)]
    assert main(["heads", "export", "SAT", *words]) == 0
    printed = [line for line in capsys.readouterr().out.splitlines() if "CREATION_DATE" not in line]
    assert printed == [line for line in reply.text.splitlines() if "CREATION_DATE" not in line]
    assert client.get(path, params=span | {"end": "2020-01-01T00:00:00Z"}).status_code == 400
    empty = {"start": "2020-01-01T00:00:00Z", "end": "2020-01-02T00:00:00Z"}
    assert "There is no attitude in this time" in client.get(path, params=empty).text
    assert client.get(f"{PATH}/99/attitudes", params=span).status_code == 404
