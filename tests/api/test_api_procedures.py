"""Procedures over HTTP: check, storage, a manual run without a device, and export of the record."""

from __future__ import annotations

import hashlib

from fastapi.testclient import TestClient

TEXT = (
    "# Sign\n\n## read: Read this\n\nText.\n\n## status: Ask\n\n```command\nGET_STATUS\n```\n\n"
    "## done: Sign\n\n```sign\nDone.\n```\n"
)


def test_an_operator_stores_runs_and_exports_a_procedure(client: TestClient) -> None:
    """A command that cannot be sent is rejected and recorded. The exported record has the hash of the run."""
    checked = client.post("/api/procedures/check", json={"text": TEXT.replace("GET_STATUS", "NOTHING")}).json()
    assert [(m["line"], m["text"].split(";")[0]) for m in checked["mistakes"]] == [(10, "unknown command")]
    stored = client.post("/api/procedures", json={"text": TEXT})
    assert (stored.status_code, stored.json()["steps"], stored.json()["mistakes"]) == (201, 3, 0)
    listed = client.get("/api/procedures").json()
    assert [p["name"] for p in listed["stored"]] == ["Sign"]
    assert listed["package"]
    run = client.post(f"/api/procedures/{stored.json()['id']}/start", json={}).json()
    path = f"/api/procedure-runs/{run['id']}"
    assert (run["current"], [s["kind"] for s in run["steps"]]) == ("read", ["text", "command", "sign"])
    assert client.post(f"{path}/step", json={"step": "status"}).status_code == 409
    assert client.post(f"{path}/step", json={"step": "read"}).json()["current"] == "status"
    rejected = client.post(f"{path}/step", json={"step": "status"})
    assert (rejected.status_code, rejected.json()["message"]) == (409, "The line is down.")
    assert client.post(f"{path}/skip", json={"step": "status", "reason": "no line"}).json()["current"] == "done"
    ended = client.post(f"{path}/step", json={"step": "done", "note": "fine"}).json()
    assert (ended["state"], ended["intact"]) == ("completed", True)
    assert [e["state"] for e in ended["entries"]] == ["done", "failed", "skipped", "done"]
    record = client.get(f"{path}/record.json").content
    assert hashlib.sha256(record).hexdigest() == ended["sha256"]
    assert client.delete(f"/api/procedures/{stored.json()['id']}").status_code == 204
    assert [r["id"] for r in client.get("/api/procedure-runs").json()] == [run["id"]]


def test_only_the_text_that_the_user_has_read_is_started(client: TestClient) -> None:
    """A start that states the hash of a text is rejected if another user has changed the text since."""
    stored = client.post("/api/procedures", json={"text": TEXT}).json()
    path, start = f"/api/procedures/{stored['id']}", {"sha256": stored["sha256"]}
    other = client.put(path, json={"text": TEXT.replace("GET_STATUS", "RESET"), "sha256": stored["sha256"]}).json()
    rejected = client.post(f"{path}/start", json=start)
    assert (rejected.status_code, "changed since" in rejected.json()["message"]) == (409, True)
    assert client.get("/api/procedure-runs", params={"procedure_id": stored["id"]}).json() == []
    run = client.post(f"{path}/start", json={"sha256": other["sha256"]}).json()
    assert client.post(f"/api/procedure-runs/{run['id']}/stop", json={"reason": "test"}).json()["state"] == "stopped"
    assert client.delete(path).status_code == 204


def test_the_runs_of_a_procedure_before_a_run(client: TestClient) -> None:
    """Only earlier runs of the same procedure are returned, newest first, also after a change of its name."""
    texts = (TEXT, TEXT.replace("# Sign", "# Other", 1))
    first, other = (client.post("/api/procedures", json={"text": text}).json()["id"] for text in texts)
    runs = []
    for procedure in (first, other, first, first):
        run = client.post(f"/api/procedures/{procedure}/start", json={}).json()
        assert client.post(f"/api/procedure-runs/{run['id']}/stop", json={"reason": "test"}).status_code == 200
        runs.append(run["id"])
    renamed = {"text": TEXT.replace("# Sign", "# Renamed", 1), "sha256": hashlib.sha256(TEXT.encode()).hexdigest()}
    assert client.put(f"/api/procedures/{first}", json=renamed).status_code == 200
    assert client.put(f"/api/procedures/{first}", json=renamed).status_code == 409

    def listed(**query: int) -> list[int]:
        return [r["id"] for r in client.get("/api/procedure-runs", params=query).json()]

    assert listed(procedure_id=first) == [runs[3], runs[2], runs[0]]
    assert listed(procedure_id=first, before=runs[3]) == [runs[2], runs[0]]
    assert listed(procedure_id=first, before=runs[3], limit=1) == [runs[2]]
    assert listed(procedure_id=other, before=runs[1]) == []
    assert listed(limit=4) == runs[::-1]
