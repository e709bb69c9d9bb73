"""Permissions of every role on every route, and of commands by their group."""

from __future__ import annotations

import re
from typing import Any

import pytest
from fastapi import FastAPI
from fastapi.routing import APIRoute, iter_route_contexts
from fastapi.testclient import TestClient

from gss.api.deps import NO_SIGN_IN, is_export, needs_of
from gss.api.guard.route_table import OPEN, SAFE_METHODS
from gss.instruments.dictionary.read_dictionary import load_dictionary
from gss.operations.accounts.permissions import ALL, COMMANDS, ROLES, permitted

ENDLESS = ("/api/stream", "/api/rerun/live")
NO_FILES = (
    "image.png",
    "thumbnail.png",
    "/raw",
    "re_viewer",
    "/rerun/{name}",
    "/api/stream",
    "/api/rerun/live",
)
"""Parts of addresses that return images or streams for the pages, which are not audited as exports."""


def routes(app: FastAPI) -> list[tuple[str, str, APIRoute]]:
    """Return (method, path, route) of all declared routes except page files and documents."""
    declared = []
    for context in iter_route_contexts(app.routes):
        route, path = context.original_route, context.path or ""
        if isinstance(route, APIRoute) and path.startswith(("/api", "/metrics")):
            declared += [(method, path, route) for method in sorted(route.methods)]
    return declared


def with_ids(path: str) -> str:
    """Return the path with ids that do not exist."""
    return re.sub(r"\{\w+\}", "999999", path)


def test_every_changing_route_declares_exactly_one_known_permission(app: FastAPI) -> None:
    """Each changing route declares one known permission. Only the routes of ``OPEN`` need no authentication."""
    changing = [(m, p, r) for m, p, r in routes(app) if m not in SAFE_METHODS]
    assert len(changing) > 60
    for method, path, route in changing:
        (need,) = needs_of(route)
        assert all(one in ALL | {"command", NO_SIGN_IN} for one in need.permission.split("|")), path
        assert (need.permission == NO_SIGN_IN) == ((method, path) in OPEN), path
    assert {(m, p) for m, p, r in routes(app) if any(n.permission == NO_SIGN_IN for n in needs_of(r))} == OPEN


def test_routes_without_authentication_are_known(app: FastAPI) -> None:
    """Only pages, their files and the documents have routes outside /api and /metrics."""
    outside = {c.path for c in iter_route_contexts(app.routes) if not (c.path or "/").startswith(("/api", "/metrics"))}
    assert all(path is None or path == "/" or path.startswith("/help") for path in outside), outside


def test_every_permission_is_used(app: FastAPI) -> None:
    """Each permission is required by a route, except for ``view`` and the permissions of commands."""
    needed = {one for _, _, route in routes(app) for need in needs_of(route) for one in need.permission.split("|")}
    assert ALL - {"view"} - set(COMMANDS) <= needed


def test_every_downloaded_file_is_audited(app: FastAPI) -> None:
    """A GET that returns something other than JSON or a picture of the page is marked as an export."""
    for method, path, route in routes(app):
        plain = route.response_class.__class__.__name__ == "DefaultPlaceholder"
        if method == "GET" and not plain and not any(word in path for word in NO_FILES) and path != "/metrics":
            assert is_export(route), path


def test_every_changing_route_rejects_every_role_without_permission(
    app: FastAPI, clients: dict[str, TestClient]
) -> None:
    """A changing route is a 401 without a session and a 403 that names the permission for every role that lacks it. An
    admin has every permission.
    """
    rejections = 0
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
            rejections += 1
        assert permitted(ROLES["admin"], need.permission), path
    assert rejections > 120


def test_nothing_is_read_without_signing_in(app: FastAPI, clients: dict[str, TestClient]) -> None:
    """Without a session, every GET is a 401, also of recordings, captures, metrics, the stream and the API
    description.
    """
    paths = [path for method, path, _ in routes(app) if method == "GET" and (method, path) not in OPEN]
    assert {"/api/stream", "/api/rerun/{name}", "/metrics", "/api/contacts/{contact_id}/captures/{file}"} <= set(paths)
    for path in [*paths, "/api/openapi.json", "/api/nothing-here", "/api", "/metrics/"]:
        reply = clients[""].get(with_ids(path))
        assert (reply.status_code, reply.json()["message"]) == (401, "Not signed in."), path


def test_admin_data_are_hidden_from_other_roles(app: FastAPI, clients: dict[str, TestClient]) -> None:
    """A GET with a separate permission is a 403 for every role that lacks it."""
    special = [(path, needs_of(route)[0]) for m, path, route in routes(app) if m == "GET" and needs_of(route)]
    special = [(path, need) for path, need in special if need.permission not in (NO_SIGN_IN, "view")]
    assert {"/api/users", "/api/sessions", "/api/tokens", "/api/audit", "/api/audit/export"} <= {p for p, _ in special}
    for path, need in special:
        for role, permissions in ROLES.items():
            if not permitted(permissions, need.permission):
                assert clients[role].get(with_ids(path)).status_code == 403, (role, path)


def test_a_viewer_may_read_everything_else(app: FastAPI, clients: dict[str, TestClient]) -> None:
    """A viewer may use every GET without a separate permission."""
    for method, path, route in routes(app):
        if method == "GET" and not needs_of(route) and path not in ENDLESS:
            assert clients["viewer"].get(with_ids(path)).status_code not in (401, 403), path


def test_no_user_raises_their_own_permissions(app: FastAPI, clients: dict[str, TestClient]) -> None:
    """Users cannot raise their permissions with their own user record, a new user, a token or a link."""
    users = app.state.services.accounts.accounts.users
    for role in ROLES:
        if role == "admin":
            continue
        user = users.named(f"the {role}")
        replies = [
            clients[role].put(f"/api/users/{user.id}", json={"role": "admin"}),
            clients[role].post("/api/users", json={"name": "eve", "role": "admin"}),
            clients[role].post("/api/tokens", json={"name": "eve", "role": "admin", "days": 1}),
            clients[role].post(f"/api/users/{user.id}/link"),
            clients[role].delete("/api/sessions/1"),
        ]
        assert [reply.status_code for reply in replies] == [403] * len(replies)
        assert users.named(f"the {role}").role == role
    assert users.named("eve") is None
    reply = clients["admin"].put(f"/api/users/{users.named('the viewer').id}", json={"role": "root"})
    assert reply.status_code == 422


def test_the_last_admin_stays(app: FastAPI, clients: dict[str, TestClient]) -> None:
    """The last admin cannot be disabled or lose the role."""
    admin = app.state.services.accounts.accounts.users.named("the admin")
    for change in ({"role": "viewer"}, {"enabled": False}):
        reply = clients["admin"].put(f"/api/users/{admin.id}", json=change)
        assert (reply.status_code, "last admin" in reply.json()["message"]) == (409, True)


GROUP_OF = {
    command.name: command.subsystem
    for command in load_dictionary().commands
    if command.name not in ("ABORT", "SCHEDULE")
}


def send(client: TestClient, name: str, **arguments: Any) -> Any:
    """Send a confirmed command."""
    return client.post("/api/commands", json={"name": name, "arguments": arguments, "confirm": name})


@pytest.mark.parametrize("role", [role for role in ROLES if role != "viewer"])
def test_a_command_needs_the_permission_of_its_group(clients: dict[str, TestClient], role: str) -> None:
    """A command without the permission of its group is a 403; otherwise it fails only because the link is closed."""
    for name, group in GROUP_OF.items():
        allowed = f"command.{group}" in ROLES[role]
        reply = send(clients[role], name)
        assert (reply.status_code == 403) is not allowed, (role, name, reply.text)
        if not allowed:
            assert f"command.{group}" in reply.json()["message"]
    clients[role].post("/api/authority/release")


def test_a_viewer_sends_nothing_but_abort(clients: dict[str, TestClient]) -> None:
    """A viewer may use the routes that stop something, but may send no command."""
    assert all(send(clients["viewer"], name).status_code == 403 for name in GROUP_OF)
    assert send(clients["viewer"], "ABORT").status_code == 403
    assert clients["viewer"].post("/api/commands/abort").status_code == 409
    assert clients["viewer"].post("/api/transfers/999999/abort").status_code == 404
    assert clients["viewer"].post("/api/transfers/999999/pause").status_code == 404
    for action in ("pause", "stop"):
        reply = clients["viewer"].post(f"/api/procedure-runs/999999/{action}", json={})
        assert reply.status_code in (404, 409)


def test_a_dry_run_lists_missing_permissions(clients: dict[str, TestClient]) -> None:
    """The check of a command lists the missing permission."""
    reply = (
        clients["engineer"].post("/api/commands/check", json={"name": "POWER", "arguments": {"state": "off"}}).json()
    )
    assert any("command.power" in problem for problem in reply["problems"])


def test_an_inner_command_needs_its_permission(app: FastAPI, clients: dict[str, TestClient], signed_in: Any) -> None:
    """SCHEDULE needs the permission of its inner command, and of every group if the inner command is unknown."""
    services = app.state.services
    scopes = ["view", "schedule", "command.processor", "command.imager"]
    token = services.accounts.accounts.tokens.add("narrow", "operator", 1, by="test", scopes=scopes)
    narrow = TestClient(app, base_url="http://localhost", headers={"Authorization": f"Bearer {token.key}"})
    codes = {c.name: c.code for c in services.line.link.dictionary.commands}
    fields = {"at_s": 1000.0, "length": 0, "payload": ""}
    names = [argument.name for argument in services.line.link.dictionary.command("SCHEDULE").arguments]
    assert set(fields) | {"command_code"} <= set(names)
    plain = {"schedule_id": 1} if "schedule_id" in names else {}
    for code, allowed in ((codes["LIST_FRAMES"], True), (codes["LIST_BANKS"], False), (60000, False)):
        reply = send(narrow, "SCHEDULE", command_code=code, **fields, **plain)
        assert (reply.status_code != 403) is allowed, (code, reply.text)


def test_an_automatic_procedure_with_one_forbidden_command_is_rejected_completely(
    app: FastAPI, clients: dict[str, TestClient]
) -> None:
    """The start is rejected before the first step, with the missing permission."""
    services = app.state.services
    steps = "".join(f"## {name.lower()[:3]}: Send\n```command\n{name}\n```\n" for name in ("GET_STATUS", "LIST_BANKS"))
    row = clients["operator"].post("/api/procedures", json={"text": f"# Mixed\n{steps}"}).json()
    assert row["mistakes"] == 0
    scopes = ["view", "procedures", "command.link"]
    token = services.accounts.accounts.tokens.add("status only", "operator", 1, by="test", scopes=scopes)
    narrow = TestClient(app, base_url="http://localhost", headers={"Authorization": f"Bearer {token.key}"})
    reply = narrow.post(f"/api/procedures/{row['id']}/start", json={"automatic": True})
    assert (reply.status_code, "command.catalogue" in reply.json()["message"]) == (403, True)
    assert narrow.get("/api/procedure-runs").json() == []


def test_solving_on_board_needs_the_permission_of_its_commands(clients: dict[str, TestClient]) -> None:
    """An engineer may upload a frame, but not with the commands that solve it on board."""
    options = {"slot": 1, "solve": True}
    reply = clients["engineer"].post("/api/frames/999999/upload", json=options)
    assert (reply.status_code, "command.attitude" in reply.json()["message"]) == (403, True)
    assert clients["engineer"].post("/api/frames/999999/upload", json=options | {"solve": False}).status_code != 403
