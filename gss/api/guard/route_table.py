"""Match requests to routes, and distinguish open routes from routes that need a permission."""

from __future__ import annotations

import re

from fastapi import APIRouter, FastAPI
from fastapi.routing import APIRoute, iter_route_contexts
from starlette.routing import compile_path
from starlette.types import Scope

from gss.api.deps import needs_of

SAFE_METHODS = ("GET", "HEAD", "OPTIONS")
HEALTH = "/api/health"
GUARDED = ("/api", "/metrics")
OPEN = {
    ("GET", "/api/session"),
    ("POST", "/api/session"),
    ("POST", "/api/setup"),
    ("POST", "/api/password-links"),
    ("POST", "/api/password-links/check"),
    ("GET", HEALTH),
}
"""API routes that need no authentication. The pages' files and the documents are also open."""


class RouteTable:
    """Finds the route of a request before the framework routes it."""

    def __init__(self, app: FastAPI) -> None:
        self._app = app
        self._routes: list[tuple[set[str], re.Pattern[str], APIRoute]] = []

    def route(self, scope: Scope) -> APIRoute | None:
        """Return the route that will handle the request; None if none matches."""
        if not self._routes:  # routes are added after the guard
            routes = [(c.original_route, c.path or "") for c in iter_route_contexts(self._app.routes)]
            self._routes = [
                (route.methods or set(), compile_path(path)[0], route)
                for route, path in routes
                if isinstance(route, APIRoute)
            ]
        matches = (
            route for methods, path, route in self._routes if scope["method"] in methods and path.match(scope["path"])
        )
        return next(matches, None)


def check_routes(router: APIRouter) -> None:
    """Check that every route with a method other than GET declares exactly one permission, so that no route is open by
    mistake. Raises RuntimeError otherwise."""
    for context in iter_route_contexts(router.routes):
        route = context.original_route
        if isinstance(route, APIRoute) and (route.methods or set()) - set(SAFE_METHODS) and len(needs_of(route)) != 1:
            raise RuntimeError(
                f"{route.path} declares {len(needs_of(route))} permissions, exactly one is required: deps.need"
            )


def is_change(scope: Scope) -> bool:
    """True if the request's method may change state."""
    return scope["method"] not in SAFE_METHODS


def is_guarded(scope: Scope) -> bool:
    """True if the path is data or metrics, not a page file."""
    path: str = scope["path"]
    return any(path == root or path.startswith(f"{root}/") for root in GUARDED)


def is_open(scope: Scope) -> bool:
    """True if the route needs no authentication."""
    return (scope["method"], scope["path"]) in OPEN


def is_health(scope: Scope) -> bool:
    """True if the request is the health check, which the server also accepts from addresses other than the proxy."""
    return (scope["method"], scope["path"]) == ("GET", HEALTH)
