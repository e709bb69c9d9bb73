"""Nobody does more than their role: every route with every role, and commands by their group."""

from __future__ import annotations

import re
from typing import Any

import pytest
from fastapi import FastAPI
from fastapi.routing import APIRoute, iter_route_contexts
from fastapi.testclient import TestClient

from gss.api.deps import NOBODY, is_export, needs_of
from gss.api.guard.door import OPEN, SAFE_METHODS
from gss.device.dictionary_file import load_dictionary
from gss.operations.accounts.permissions import ALL, COMMANDS, ROLES, permitted

ENDLESS = ("/api/stream", "/api/rerun/live")
NO_FILES = (
    "image.png",
    "thumbnail.png",
    "/raw",
    "re_viewer",
    "favicon",
    "/rerun/{name}",
    "/api/stream",
    "/api/rerun/live",
)
"""Drawn by the pages as one looks at them: not taken away as a file."""


def routes(app: FastAPI) -> list[tuple[str, str, APIRoute]]:
    """(method, path, route) of everything that is declared, without the pages' files and documents."""
    found = []
    for context in iter_route_contexts(app.routes):
        route, path = context.original_route, context.path or ""
        if isinstance(route, APIRoute) and path.startswith(("/api", "/metrics")):
            found += [(method, path, route) for method in sorted(route.methods)]
    return found


def with_ids(path: str) -> str:
    """An address whose ids nothing has."""
    return re.sub(r"\{\w+\}", "999999", path)


def test_every_changing_route_declares_exactly_one_known_permission(app: FastAPI) -> None:
    """And only signing in, setting up and using a link are open to nobody in particular."""
    changing = [(m, p, r) for m, p, r in routes(app) if m not in SAFE_METHODS]
    assert len(changing) > 60
    for method, path, route in changing:
        (need,) = needs_of(route)
        assert all(one in ALL | {"command", NOBODY} for one in need.permission.split("|")), path
        assert (need.permission == NOBODY) == ((method, path) in OPEN), path
    assert {(m, p) for m, p, r in routes(app) if any(n.permission == NOBODY for n in needs_of(r))} == OPEN


def test_what_is_outside_the_guard_is_known(app: FastAPI) -> None:
    """Pages, their files, and the documents: nothing else answers outside /api and /metrics."""
    outside = {c.path for c in iter_route_contexts(app.routes) if not (c.path or "/").startswith(("/api", "/metrics"))}
    assert all(path is None or path == "/" or path.startswith("/help") for path in outside), outside


def test_every_permission_is_needed_somewhere(app: FastAPI) -> None:
    """None is only a word in the table."""
    needed = {one for _, _, route in routes(app) for need in needs_of(route) for one in need.permission.split("|")}
    assert ALL - {"view"} - set(COMMANDS) <= needed


def test_every_file_that_is_taken_away_is_on_the_record(app: FastAPI) -> None:
    """A GET that answers with something else than JSON or a picture of the page is marked as an export."""
    for method, path, route in routes(app):
        plain = route.response_class.__class__.__name__ == "DefaultPlaceholder"
        if method == "GET" and not plain and not any(word in path for word in NO_FILES) and path != "/metrics":
            assert is_export(route), path


def test_every_changing_route_refuses_every_role_that_lacks_it(app: FastAPI, clients: dict[str, TestClient]) -> None:
    """Route by route and role by role: 401 for nobody, 403 with the permission in words for those without; whoever has it gets
    past the door (and is told what is wrong with an empty request)."""
    tried = 0
    for method, path, route in routes(app):
        if method in SAFE_METHODS or (method, path) in OPEN or path in ("/api/session", "/api/session/password"):
            continue
        (need,) = needs_of(route)
        assert clients[""].request(method, with_ids(path)).status_code == 401, path
        for role, permissions in ROLES.items():
            if permitted(permissions, need.permission):
                continue
            reply = clients[role].request(method, with_ids(path))
            assert (reply.status_code, need.permission.split("|")[0] in reply.json()["message"]) == (403, True), (
                role,
                path,
            )
            tried += 1
        assert permitted(ROLES["admin"], need.permission), path
    assert tried > 120


def test_nothing_is_read_without_signing_in(app: FastAPI, clients: dict[str, TestClient]) -> None:
    """Recordings, captures, rerun files, frames, metrics, the stream, the API's own description."""
    paths = [path for method, path, _ in routes(app) if method == "GET" and (method, path) not in OPEN]
    assert {"/api/stream", "/api/rerun/{name}", "/metrics", "/api/contacts/{contact_id}/captures/{file}"} <= set(paths)
    for path in [*paths, "/api/openapi.json", "/api/nothing-here", "/api", "/metrics/"]:
        reply = clients[""].get(with_ids(path))
        assert (reply.status_code, reply.json()["message"]) == (401, "nobody is signed in"), path


def test_what_only_admins_may_see_nobody_else_sees(app: FastAPI, clients: dict[str, TestClient]) -> None:
    """GETs that declare more than looking."""
    special = [(path, needs_of(route)[0]) for m, path, route in routes(app) if m == "GET" and needs_of(route)]
    special = [(path, need) for path, need in special if need.permission not in (NOBODY, "view")]
    assert {"/api/users", "/api/sessions", "/api/tokens", "/api/audit", "/api/audit/export"} <= {p for p, _ in special}
    for path, need in special:
        for role, permissions in ROLES.items():
            if not permitted(permissions, need.permission):
                assert clients[role].get(with_ids(path)).status_code == 403, (role, path)


def test_a_viewer_may_look_at_everything_else(app: FastAPI, clients: dict[str, TestClient]) -> None:
    """No GET without a declaration of its own refuses the least of the roles."""
    for method, path, route in routes(app):
        if method == "GET" and not needs_of(route) and path not in ENDLESS:
            assert clients["viewer"].get(with_ids(path)).status_code not in (401, 403), path


def test_nobody_raises_themselves(app: FastAPI, clients: dict[str, TestClient]) -> None:
    """Not by their own row, a new user, a token, or a field that does not belong there."""
    users = app.state.services.accounts.users
    for role in ROLES:
        if role == "admin":
            continue
        own = users.named(f"the {role}")
        tries = [
            clients[role].put(f"/api/users/{own.id}", json={"role": "admin"}),
            clients[role].post("/api/users", json={"name": "eve", "role": "admin"}),
            clients[role].post("/api/tokens", json={"name": "eve", "role": "admin", "days": 1}),
            clients[role].post(f"/api/users/{own.id}/link"),
            clients[role].delete("/api/sessions/1"),
        ]
        assert [reply.status_code for reply in tries] == [403] * len(tries)
        assert users.named(f"the {role}").role == role
    assert users.named("eve") is None
    reply = clients["admin"].put(f"/api/users/{users.named('the viewer').id}", json={"role": "root"})
    assert reply.status_code == 422


def test_the_last_admin_stays(app: FastAPI, clients: dict[str, TestClient]) -> None:
    """Neither by mistake nor by malice is a server left without one."""
    own = app.state.services.accounts.users.named("the admin")
    for change in ({"role": "viewer"}, {"enabled": False}):
        reply = clients["admin"].put(f"/api/users/{own.id}", json=change)
        assert (reply.status_code, "last admin" in reply.json()["message"]) == (409, True)


GROUP_OF = {
    command.name: command.subsystem
    for command in load_dictionary().commands
    if command.name not in ("ABORT", "SCHEDULE")
}


def send(client: TestClient, name: str, **arguments: Any) -> Any:
    """A command, confirmed."""
    return client.post("/api/commands", json={"name": name, "arguments": arguments, "confirm": name})


@pytest.mark.parametrize("role", [role for role in ROLES if role != "viewer"])
def test_a_command_needs_the_permission_of_its_group(clients: dict[str, TestClient], role: str) -> None:
    """Where the role has the group the refusal is the line's (there is none here), else it is the permission's."""
    for name, group in GROUP_OF.items():
        allowed = f"command.{group}" in ROLES[role]
        reply = send(clients[role], name)
        assert (reply.status_code == 403) is not allowed, (role, name, reply.text)
        if not allowed:
            assert f"command.{group}" in reply.json()["message"]
    clients[role].post("/api/authority/release")


def test_a_viewer_sends_nothing_but_abort(clients: dict[str, TestClient]) -> None:
    """Stopping is everybody's: ABORT only fails because there is no line."""
    assert all(send(clients["viewer"], name).status_code == 403 for name in GROUP_OF)
    assert send(clients["viewer"], "ABORT").status_code == 403
    assert clients["viewer"].post("/api/commands/abort").status_code == 409
    assert clients["viewer"].post("/api/transfers/999999/abort").status_code == 404
    assert clients["viewer"].post("/api/transfers/999999/pause").status_code == 404
    assert clients["viewer"].post("/api/stack-runs/999999/stop").status_code in (404, 409)


def test_a_dry_run_says_what_the_role_lacks(clients: dict[str, TestClient]) -> None:
    """Before anything is sent."""
    reply = (
        clients["engineer"].post("/api/commands/check", json={"name": "POWER", "arguments": {"state": "off"}}).json()
    )
    assert any("command.power" in problem for problem in reply["problems"])


def test_no_command_hides_inside_another(app: FastAPI, clients: dict[str, TestClient], signed_in: Any) -> None:
    """SCHEDULE needs the permission of what it carries, and every group's where that cannot be read."""
    services = app.state.services
    scopes = ["view", "schedule", "command.processor", "command.imager"]
    token = services.accounts.tokens.add("narrow", "operator", 1, by="test", scopes=scopes)
    narrow = TestClient(app, base_url="http://localhost", headers={"Authorization": f"Bearer {token.key}"})
    codes = {c.name: c.code for c in services.link.dictionary.commands}
    fields = {"at_s": 1000.0, "length": 0, "payload": ""}
    names = [argument.name for argument in services.link.dictionary.command("SCHEDULE").arguments]
    assert set(fields) | {"command_code"} <= set(names)
    plain = {"schedule_id": 1} if "schedule_id" in names else {}
    for code, allowed in ((codes["LIST_FRAMES"], True), (codes["LIST_BANKS"], False), (60000, False)):
        reply = send(narrow, "SCHEDULE", command_code=code, **fields, **plain)
        assert (reply.status_code != 403) is allowed, (code, reply.text)


def test_a_stack_with_one_forbidden_command_is_refused_whole(app: FastAPI, clients: dict[str, TestClient]) -> None:
    """Before its first step; the dry run names the step."""
    services = app.state.services
    steps = [{"command": "GET_STATUS"}, {"command": "LIST_BANKS"}]
    row = clients["operator"].post("/api/stacks", json={"name": "mixed", "note": "", "steps": steps}).json()
    scopes = ["view", "stacks", "command.link"]
    token = services.accounts.tokens.add("status only", "operator", 1, by="test", scopes=scopes)
    narrow = TestClient(app, base_url="http://localhost", headers={"Authorization": f"Bearer {token.key}"})
    reply = narrow.post(f"/api/stacks/{row['id']}/run", json={"confirm": []})
    assert (reply.status_code, "command.catalogue" in reply.json()["message"]) == (403, True)
    problems = narrow.post(f"/api/stacks/{row['id']}/check").json()["problems"]
    assert any(text.startswith("step 2") and "command.catalogue" in text for text in problems)
    assert narrow.get("/api/stack-runs").json() == []


def test_solving_on_board_needs_the_permission_of_its_commands(clients: dict[str, TestClient]) -> None:
    """Sending a frame up may be an engineer's, what the server then commands for it is not."""
    asked = {"slot": 1, "solve": True}
    reply = clients["engineer"].post("/api/frames/999999/upload", json=asked)
    assert (reply.status_code, "command.attitude" in reply.json()["message"]) == (403, True)
    assert clients["engineer"].post("/api/frames/999999/upload", json=asked | {"solve": False}).status_code != 403
