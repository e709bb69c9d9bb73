"""Which route a request is for, and who may ask for it: nobody in particular, or those whom the route's own permission lets in."""

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
"""What is answered to nobody in particular, besides the pages' own files and the documents."""


class Door:
    """Which route a request is for, before the framework asks."""

    def __init__(self, app: FastAPI) -> None:
        self._app = app
        self._routes: list[tuple[set[str], re.Pattern[str], APIRoute]] = []

    def route(self, scope: Scope) -> APIRoute | None:
        """The route that will answer; None where there is none."""
        if not self._routes:  # the routes come after the guard
            found = [(c.original_route, c.path or "") for c in iter_route_contexts(self._app.routes)]
            self._routes = [
                (route.methods or set(), compile_path(path)[0], route)
                for route, path in found
                if isinstance(route, APIRoute)
            ]
        fitting = (
            route for methods, path, route in self._routes if scope["method"] in methods and path.match(scope["path"])
        )
        return next(fitting, None)


def check_routes(router: APIRouter) -> None:
    """Every route that is no GET declares exactly one permission: what was forgotten must not be open."""
    for context in iter_route_contexts(router.routes):
        route = context.original_route
        if isinstance(route, APIRoute) and (route.methods or set()) - set(SAFE_METHODS) and len(needs_of(route)) != 1:
            raise RuntimeError(f"{route.path} declares {len(needs_of(route))} permissions, it must be one: deps.need")


def is_change(scope: Scope) -> bool:
    """Does it ask for more than an answer?"""
    return scope["method"] not in SAFE_METHODS


def is_guarded(scope: Scope) -> bool:
    """Is it data, not a page's own file?"""
    path: str = scope["path"]
    return any(path == root or path.startswith(f"{root}/") for root in GUARDED)


def is_open(scope: Scope) -> bool:
    """Is it answered to nobody in particular?"""
    return (scope["method"], scope["path"]) in OPEN


def is_health(scope: Scope) -> bool:
    """Is it the look of a health check, which may come past the proxy?"""
    return (scope["method"], scope["path"]) == ("GET", HEALTH)
