"""Long work and transfers are ordered by who may order their kind, through every door."""

from __future__ import annotations

from typing import Any

import pytest
from fastapi import FastAPI
from fastapi.routing import APIRoute, iter_route_contexts
from fastapi.testclient import TestClient

from gss.api.deps import needs_of
from gss.operations.accounts.permissions import ROLES
from gss.operations.clock import utc_now
from gss.operations.jobs import PERMISSIONS, RESUMABLE_KINDS
from gss.store.models import Job, Transfer

STARTED_AT = {
    "experiments": "/api/campaigns/experiments",
    "campaign": "/api/campaigns/experiments",
    "reprocess": "/api/campaigns/reprocess",
    "catalogue": "/api/catalogues",
    "design": "/api/design/run",
    "calibration": "/api/calibrations",
    "analysis": "/api/analyses",
    "backup": "/api/admin/backups",
    "retention": "/api/admin/retention/run",
    "check-store": "/api/admin/check-store",
}


def stored(app: FastAPI, row: Any) -> int:
    """The id of a row that is put into the store as it is."""
    with app.state.services.database.unit_of_work() as session:
        session.add(row)
        session.flush()
        return int(row.id)


def a_job(app: FastAPI, kind: str, state: str, user: str = "somebody") -> int:
    """The id of a job that nobody does."""
    row = Job(kind=kind, title="t", state=state, created=utc_now(), request={"user": user}, result={})
    return stored(app, row)


def declared(app: FastAPI) -> dict[str, str]:
    """What each POST route needs."""
    found = [(c.path or "", c.original_route) for c in iter_route_contexts(app.routes)]
    return {p: needs_of(r)[0].permission for p, r in found if isinstance(r, APIRoute) and "POST" in r.methods}


def test_a_job_is_ordered_again_only_by_who_may_start_its_kind(app: FastAPI, clients: dict[str, TestClient]) -> None:
    """What the route that starts it needs, its second start and its end need too; of an unknown kind all but admins are
    refused."""
    needs = declared(app)
    assert {kind: needs[path] for kind, path in STARTED_AT.items()} == PERMISSIONS
    assert set(PERMISSIONS) == set(RESUMABLE_KINDS)
    tried = 0
    for kind in (*PERMISSIONS, "unheard of"):
        ended, running = a_job(app, kind, "done"), a_job(app, kind, "running")
        wanted = PERMISSIONS.get(kind, "admin.users")
        for role, permissions in ROLES.items():
            if wanted in permissions or "jobs.cancel" not in permissions:
                continue
            for path in (f"/api/jobs/{ended}/again", f"/api/jobs/{running}/cancel"):
                reply = clients[role].post(path)
                assert (reply.status_code, wanted in reply.json()["message"]) == (403, True), (role, kind, path)
                tried += 1
        assert clients["admin"].post(f"/api/jobs/{running}/cancel").status_code == 200
    assert tried > 40
    own = a_job(app, "backup", "running", "the engineer")
    assert clients["operator"].post(f"/api/jobs/{own}/cancel").status_code == 403
    assert clients["engineer"].post(f"/api/jobs/{own}/cancel").status_code == 200


@pytest.mark.parametrize(
    ("kind", "place", "wanted"),
    [
        ("frame", {"slot": 0}, "frames.transfer"),
        ("star_windows", {"slot": 0}, "frames.transfer"),
        ("catalogue", {"bank": "A"}, "catalogues.upload"),
        ("parameters", {"bank": "factory"}, "tables"),
    ],
)
def test_a_transfer_needs_the_permission_of_its_kind(
    app: FastAPI, clients: dict[str, TestClient], kind: str, place: dict[str, Any], wanted: str
) -> None:
    """To bring it down and to go on with it; having one of the three is not enough."""
    names = {"direction": "down", "kind": kind, "target": "0", "subject": "t", "state": "verified"}
    row = stored(app, Transfer(created=utc_now(), stored=[], options={}, log=[], **names))
    for role, permissions in ROLES.items():
        for path, body in (
            ("/api/transfers/download", {"kind": kind, **place}),
            (f"/api/transfers/{row}/resume", None),
        ):
            reply = clients[role].post(path, json=body)
            # Who may is told what really stands in the way: there is no line, and it has ended.
            assert reply.status_code == (409 if wanted in permissions else 403), (role, path, reply.text)
            clients[role].post("/api/authority/release")


def test_going_on_with_a_frame_to_be_solved_needs_what_sending_it_needed(
    app: FastAPI, clients: dict[str, TestClient]
) -> None:
    """Its commands are sent by the server, in the name of who went on with it."""
    names = {"direction": "up", "kind": "image", "target": "0", "subject": "t", "state": "failed"}
    row = stored(app, Transfer(created=utc_now(), stored=[], options={"solve": True}, log=[], **names))
    reply = clients["engineer"].post(f"/api/transfers/{row}/resume")
    assert (reply.status_code, "command.attitude" in reply.json()["message"]) == (403, True)
