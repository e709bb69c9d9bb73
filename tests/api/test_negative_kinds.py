"""Jobs and transfers need the permission of their kind on every route that starts, repeats or cancels them."""

from __future__ import annotations

from typing import Any

import pytest
from fastapi import FastAPI
from fastapi.routing import APIRoute, iter_route_contexts
from fastapi.testclient import TestClient

from gss.api.deps import needs_of
from gss.operations.accounts.permissions import ROLES
from gss.operations.clock import utc_now
from gss.operations.job_rules import PERMISSIONS
from gss.store.models import Job, Transfer

STARTED_AT = {
    "experiments": "/api/campaigns/experiments",
    "campaign": "/api/campaigns/experiments",
    "reprocess": "/api/campaigns/reprocess",
    "catalogue": "/api/catalogues",
    "design": "/api/design/run",
    "calibration": "/api/calibrations",
    "analysis": "/api/analyses",
    "lists": "/api/lists",
    "instrument": "/api/instruments/photographs",
    "rehearsal": "/api/pass-plans/{plan_id}/rehearsals",
    "derive": "/api/telemetry/derived/{name}/recompute",
    "backup": "/api/admin/backups",
    "retention": "/api/admin/retention/run",
    "check-store": "/api/admin/check-store",
}


def store_row(app: FastAPI, row: Any) -> int:
    """Store a row and return its id."""
    with app.state.services.base.database.unit_of_work() as session:
        session.add(row)
        session.flush()
        return int(row.id)


def store_job(app: FastAPI, kind: str, state: str, user: str = "operator") -> int:
    """Store a job that no worker runs and return its id."""
    row = Job(kind=kind, title="t", state=state, created=utc_now(), request={"user": user}, result={})
    return store_row(app, row)


def permissions_of_routes(app: FastAPI) -> dict[str, str]:
    """Return the permission of each POST route."""
    contexts = [(c.path or "", c.original_route) for c in iter_route_contexts(app.routes)]
    return {p: needs_of(r)[0].permission for p, r in contexts if isinstance(r, APIRoute) and "POST" in r.methods}


def test_restarting_a_job_needs_the_permission_of_its_kind(app: FastAPI, clients: dict[str, TestClient]) -> None:
    """Starting, restarting and cancelling a job need the same permission. A job of an unknown kind needs an admin."""
    needs = permissions_of_routes(app)
    assert {kind: needs[path] for kind, path in STARTED_AT.items()} == PERMISSIONS
    assert set(app.state.services.base.jobs._kinds) <= set(PERMISSIONS)
    requests = 0
    for kind in (*PERMISSIONS, "unheard of"):
        ended, running = store_job(app, kind, "done"), store_job(app, kind, "running")
        permission = PERMISSIONS.get(kind, "admin.users")
        for role, permissions in ROLES.items():
            if permission in permissions or "jobs.cancel" not in permissions:
                continue
            for path in (f"/api/jobs/{ended}/again", f"/api/jobs/{running}/cancel"):
                reply = clients[role].post(path)
                assert (reply.status_code, permission in reply.json()["message"]) == (403, True), (role, kind, path)
                requests += 1
        assert clients["admin"].post(f"/api/jobs/{running}/cancel").status_code == 200
    assert requests > 40
    own_job = store_job(app, "backup", "running", "the engineer")
    assert clients["operator"].post(f"/api/jobs/{own_job}/cancel").status_code == 403
    assert clients["engineer"].post(f"/api/jobs/{own_job}/cancel").status_code == 200


@pytest.mark.parametrize(
    ("kind", "source", "permission"),
    [
        ("frame", {"slot": 0}, "frames.transfer"),
        ("star_windows", {"slot": 0}, "frames.transfer"),
        ("catalogue", {"bank": "A"}, "catalogues.upload"),
        ("parameters", {"bank": "factory"}, "tables"),
    ],
)
def test_a_transfer_needs_the_permission_of_its_kind(
    app: FastAPI, clients: dict[str, TestClient], kind: str, source: dict[str, Any], permission: str
) -> None:
    """Downloading and resuming a transfer need the permission of its kind; another transfer permission is not
    sufficient.
    """
    names = {"direction": "down", "kind": kind, "target": "0", "subject": "t", "state": "verified"}
    row = store_row(app, Transfer(created=utc_now(), stored=[], options={}, log=[], **names))
    for role, permissions in ROLES.items():
        for path, body in (
            ("/api/transfers/download", {"kind": kind, **source}),
            (f"/api/transfers/{row}/resume", None),
        ):
            reply = clients[role].post(path, json=body)
            # With the permission the actual reason is returned: the link is closed, and the transfer has ended.
            assert reply.status_code == (409 if permission in permissions else 403), (role, path, reply.text)
            clients[role].post("/api/authority/release")


def test_resuming_an_upload_to_be_solved_needs_the_permission_of_the_upload(
    app: FastAPI, clients: dict[str, TestClient]
) -> None:
    """Resuming needs the command permission, because the server sends commands on behalf of the user who resumes it."""
    names = {"direction": "up", "kind": "image", "target": "0", "subject": "t", "state": "failed"}
    row = store_row(app, Transfer(created=utc_now(), stored=[], options={"solve": True}, log=[], **names))
    reply = clients["engineer"].post(f"/api/transfers/{row}/resume")
    assert (reply.status_code, "command.attitude" in reply.json()["message"]) == (403, True)
