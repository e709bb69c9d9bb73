"""API workers answer exactly the routes in the table; they forward all others."""

from __future__ import annotations

import re

from gss.api.workers.local_routes import LOCAL, is_local


def test_the_table_alone_decides_which_routes_are_local(client):
    """Each entry of the table is a route of the application. Every other data route is forwarded, with any
    parameters.
    """
    paths = client.get("/api/openapi.json").json()["paths"]
    routes = {(method.upper(), path) for path, methods in paths.items() for method in methods}
    local_routes = {(method, path) for method, templates in LOCAL.items() for path in templates}
    assert local_routes - routes <= {
        ("GET", "/api/openapi.json"),
        ("GET", "/api/rerun/re_viewer.js"),
        ("GET", "/api/rerun/re_viewer_bg.wasm"),
    }
    for method, template in sorted(routes - local_routes):
        for word in ("7", "abc"):
            path = re.sub(r"\{\w+\}", word, template)
            assert not is_local(method, path), (method, path)
    assert not any(is_local(method, "/api/commands") for method in ("GET", "POST"))
    assert not is_local("GET", "/api/rerun/live")
    assert not is_local("GET", "/metrics")
    assert is_local("GET", "/live")
