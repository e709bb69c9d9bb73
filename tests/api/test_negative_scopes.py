"""A token has only the permissions of its scopes."""

from __future__ import annotations

import re
from typing import Any

import pytest
from fastapi import FastAPI
from fastapi.routing import APIRoute, iter_route_contexts
from fastapi.testclient import TestClient

from gss.api.deps import needs_of
from gss.api.guard.route_table import OPEN
from gss.operations.accounts.permissions import ALL

UNDECLARED = "view"
"""Permission of routes that declare none."""
ENDLESS = {"/api/stream", "/api/rerun/live"}


def routes(app: FastAPI) -> list[tuple[str, str, str]]:
    """Return method, address with ids that do not exist, and declared permission of every authenticated route."""
    declared = [("GET", "/api/openapi.json", UNDECLARED)]
    for context in iter_route_contexts(app.routes):
        route, path = context.original_route, context.path or ""
        if isinstance(route, APIRoute) and path.startswith(("/api", "/metrics")):
            (permission,) = [need.permission for need in needs_of(route)] or [UNDECLARED]
            address = re.sub(r"\{\w+\}", "999999", path)
            declared += [
                (method, address, permission) for method in sorted(route.methods) if (method, path) not in OPEN
            ]
    return declared


def includes_scope(permission: str, scope: str) -> bool:
    """True if the scope is one of the alternatives that a route declares."""
    return any(part == scope or (part == "command" and scope.startswith("command.")) for part in permission.split("|"))


def client_with_scopes(app: FastAPI, name: str, *scopes: str) -> TestClient:
    """Return a client with an admin's token that is limited to ``scopes``."""
    token = app.state.services.accounts.accounts.tokens.add(name, "admin", 1, by="test", scopes=scopes)
    headers = {"Authorization": f"Bearer {token.key}"}
    return TestClient(app, base_url="http://localhost", headers=headers, raise_server_exceptions=False)


def test_every_route_rejects_a_token_with_all_scopes_but_its_own(app: FastAPI) -> None:
    """A token with all scopes except those of a route is rejected, for every route."""
    clients: dict[str, TestClient] = {}
    for method, path, permission in routes(app):
        if permission not in clients:
            others = [scope for scope in sorted(ALL) if not includes_scope(permission, scope)]
            clients[permission] = client_with_scopes(app, f"all but {permission}", *others)
        reply = clients[permission].request(method, path)
        assert (reply.status_code, method, path) == (403, method, path)
        assert "Permission required:" in reply.json()["message"]
    assert len(clients) > 30


def test_a_token_of_one_scope_reads_what_names_it(app: FastAPI) -> None:
    """A GET route that names the scope accepts a token with only this scope."""
    readable = [
        (path, permission) for method, path, permission in routes(app) if method == "GET" and path not in ENDLESS
    ]
    for scope in sorted(ALL):
        client = client_with_scopes(app, f"only {scope}", scope)
        for path in (path for path, permission in readable if includes_scope(permission, scope)):
            assert client.get(path).status_code not in (401, 403), path


@pytest.mark.parametrize("path", ["/api/commands/abort", "/api/transfers/999999/abort", "/api/transfers/999999/pause"])
def test_stopping_is_open_to_users_unlimited_tokens_and_scope_stop(
    app: FastAPI, clients: dict[str, TestClient], path: str
) -> None:
    """Every role and every unlimited token may stop actions. A limited token needs the scope ``stop``."""
    unlimited = client_with_scopes(app, f"whole {path}")
    limited_to_stop = client_with_scopes(app, f"stop {path}", "stop")
    allowed: list[Any] = [unlimited, limited_to_stop, *(client for role, client in clients.items() if role)]
    assert {client.post(path).status_code for client in allowed} <= {404, 409}
    assert client_with_scopes(app, f"figures {path}", "metrics").post(path).status_code == 403


def test_abort_as_a_command_needs_the_scope_too(app: FastAPI) -> None:
    """A token that may send commands of the group of ABORT also needs the scope ``stop`` for ABORT."""
    abort = {"name": "ABORT", "arguments": {}, "confirm": ""}
    accepted = client_with_scopes(app, "with stop", "view", "command.link", "stop").post("/api/commands", json=abort)
    assert (accepted.status_code, accepted.json()["message"]) == (409, "ABORT was not sent: the line is down.")
    rejected = client_with_scopes(app, "without stop", "view", "command.link").post("/api/commands", json=abort)
    assert (rejected.status_code, rejected.json()["message"]) == (403, "Permission required: stop.")
