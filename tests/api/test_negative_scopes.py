"""A token has only the permissions of its scopes: tokens of every single scope against every route."""

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
"""The permission of a route that declares none."""
ENDLESS = {"/api/stream", "/api/rerun/live"}


def routes(app: FastAPI) -> list[tuple[str, str, str]]:
    """Return method, address with ids that do not exist, and declared permission of every authenticated route."""
    found = [("GET", "/api/openapi.json", UNDECLARED)]
    for context in iter_route_contexts(app.routes):
        route, path = context.original_route, context.path or ""
        if isinstance(route, APIRoute) and path.startswith(("/api", "/metrics")):
            (permission,) = [need.permission for need in needs_of(route)] or [UNDECLARED]
            address = re.sub(r"\{\w+\}", "999999", path)
            found += [(method, address, permission) for method in sorted(route.methods) if (method, path) not in OPEN]
    return found


def names(permission: str, scope: str) -> bool:
    """True if the scope is among the alternatives that a route declares."""
    return any(one == scope or (one == "command" and scope.startswith("command.")) for one in permission.split("|"))


def scoped(app: FastAPI, name: str, *scopes: str) -> TestClient:
    """Return a program with an admin's token, limited to ``scopes``."""
    token = app.state.services.accounts.accounts.tokens.add(name, "admin", 1, by="test", scopes=scopes)
    headers = {"Authorization": f"Bearer {token.key}"}
    return TestClient(app, base_url="http://localhost", headers=headers, raise_server_exceptions=False)


@pytest.mark.parametrize("scope", sorted(ALL))
def test_a_token_of_one_scope_is_rejected_by_every_route_that_needs_another(app: FastAPI, scope: str) -> None:
    """Reading, changing, commanding and stopping alike; a route that names the scope accepts it."""
    client, tried = scoped(app, f"only {scope}", scope), 0
    for method, path, permission in routes(app):
        if names(permission, scope):
            if path not in ENDLESS and method == "GET":
                assert client.request(method, path).status_code not in (401, 403), (method, path)
            continue
        reply = client.request(method, path)
        assert (reply.status_code, method, path) == (403, method, path)
        assert "permission required:" in reply.json()["message"]
        tried += 1
    assert tried > 80


@pytest.mark.parametrize("path", ["/api/commands/abort", "/api/transfers/999999/abort", "/api/transfers/999999/pause"])
def test_stopping_is_open_to_users_unlimited_tokens_and_scope_stop(
    app: FastAPI, clients: dict[str, TestClient], path: str
) -> None:
    """Every role and every unlimited token may stop without further permission; a limited token needs the scope stop."""
    whole = scoped(app, f"whole {path}")
    stopper = scoped(app, f"stop {path}", "stop")
    allowed: list[Any] = [whole, stopper, *(client for role, client in clients.items() if role)]
    assert {client.post(path).status_code for client in allowed} <= {404, 409}
    assert scoped(app, f"figures {path}", "metrics").post(path).status_code == 403


def test_abort_as_a_command_needs_the_scope_too(app: FastAPI) -> None:
    """A token that may send commands of ABORT's group still needs stop for it."""
    abort = {"name": "ABORT", "arguments": {}, "confirm": ""}
    may = scoped(app, "with stop", "view", "command.link", "stop").post("/api/commands", json=abort)
    assert (may.status_code, may.json()["message"]) == (409, "ABORT was not sent: the line is down")
    refused = scoped(app, "without stop", "view", "command.link").post("/api/commands", json=abort)
    assert (refused.status_code, refused.json()["message"]) == (403, "permission required: stop")
