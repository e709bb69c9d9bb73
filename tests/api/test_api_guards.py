"""Access control by network address, origin, host name and request size."""

from __future__ import annotations

import json

import pytest
from fastapi import APIRouter
from fastapi.testclient import TestClient

from gss.api.guard.perimeter import check_exposure
from gss.api.guard.route_table import check_routes
from gss.domain.errors import BadInput
from gss.settings import Settings


def test_every_response_has_the_strict_policy(client):
    """Pages, data and errors have the content security policy and related headers."""
    for path in ("/api/health", "/api/frames/999", "/nowhere"):
        headers = client.get(path).headers
        assert "default-src 'self'" in headers["content-security-policy"]
        assert "'unsafe-eval'" not in headers["content-security-policy"].replace("'wasm-unsafe-eval'", "")
        assert headers["x-content-type-options"] == "nosniff"


def test_a_foreign_page_can_neither_read_nor_change(client):
    """Requests from another origin, for another host name (DNS rebinding) or without the CSRF token are rejected."""
    assert client.get("/api/link", headers={"Origin": "http://evil.example"}).status_code == 403
    assert client.get("/api/link", headers={"Host": "evil.example"}).status_code == 403
    reply = client.post("/api/link/close", headers={"Origin": "http://evil.example"})
    assert reply.status_code == 403
    without_token = client.build_request("POST", "/api/link/close")
    del without_token.headers["X-GSS"]
    reply = client.send(without_token)
    assert (reply.status_code, reply.json()["message"]) == (403, "The CSRF token is missing or wrong.")


def test_our_own_page_is_accepted(client):
    """A request of the same origin is accepted."""
    reply = client.post("/api/link/close", headers={"Origin": "http://localhost"})
    assert reply.status_code == 200


def test_a_body_beyond_the_limit_is_rejected_before_it_is_read(client):
    """The declared length is sufficient to reject a request."""
    reply = client.post("/api/frames/import", headers={"Content-Length": str(1 << 30)}, content=b"x")
    assert reply.status_code == 413


@pytest.mark.parametrize("host", ["127.0.0.1", "127.8.8.8", "::1", "localhost"])
def test_loopback_addresses_are_permitted_for_listening(host):
    """The server may listen on every loopback address."""
    check_exposure(Settings(host=host))


@pytest.mark.parametrize("host", ["192.168.1.5", "example.org", "", "::", "0.0.0.0"])  # noqa: S104 - that is the point
def test_other_addresses_need_tls_or_a_proxy(host):
    """Other addresses are accepted with complete settings for TLS or a proxy, and rejected with incomplete ones."""
    with pytest.raises(BadInput, match="loopback only"):
        check_exposure(Settings(host=host))
    check_exposure(Settings(host=host, tls_certificate="c.pem", tls_key="k.pem"))
    check_exposure(Settings(host=host, behind_proxy=True, public_names="gss.example.org"))
    for incomplete in ({"tls_certificate": "c.pem"}, {"tls_key": "k.pem"}, {"behind_proxy": True}):
        with pytest.raises(BadInput):
            check_exposure(Settings(host=host, **incomplete))
    with pytest.raises(BadInput, match="list of proxies"):
        check_exposure(Settings(behind_proxy=True, public_names="x.org", trusted_proxies="everybody"))


@pytest.mark.parametrize(
    ("path", "body"),
    [
        ("campaigns/reprocess", {"frame_ids": [10**30]}),
        ("campaigns/reprocess", {"contact": 10**20}),
        ("calibrations", {"kind": "detector", "profile": "cubestar", "dark_ids": [1], "flat_pairs": [[10**20, 1]]}),
        ("calibrations", {"kind": "bench-centre", "profile": "cubestar", "dots_px": [[1e308, -1e308]] * 8}),
        ("calibrations", {"kind": "bench-focus", "profile": "cubestar", "widths": [[1, 1e300]] * 8}),
        ("catalogues/preview", {"orbit": "elements", "raan_deg": [-1e300, 1e300]}),
        ("catalogues/preview", {"orbit": "elements", "mounting_deg": [1e308, 0, 0]}),
    ],
)
def test_numbers_out_of_range_are_rejected_by_the_schema(
    client: TestClient, path: str, body: dict[str, object]
) -> None:
    """Impossible ids, sizes and angles are rejected with a 422."""
    reply = client.post(f"/api/{path}", json=body)
    assert reply.status_code == 422, reply.text


def test_every_id_in_a_request_is_bounded(client: TestClient) -> None:
    """Every id in a request schema has a maximum, because the database has 32-bit ids."""
    schemas = client.app.openapi()["components"]["schemas"]
    for name, schema in schemas.items():
        if name.endswith("In"):
            for field, rule in schema.get("properties", {}).items():
                if field.endswith(("_id", "_ids", "contact", "star_list", "flat_pairs")):
                    assert '"maximum"' in json.dumps(rule), f"{name}.{field}"


def test_a_changing_route_without_a_permission_stops_the_start():
    """A router that forgets it is a fault of the program, found before a request can be served."""
    router = APIRouter()

    @router.get("/read")
    def read() -> None: ...

    check_routes(router)

    @router.post("/change")
    def change() -> None: ...

    with pytest.raises(RuntimeError, match="/change declares 0 permissions, exactly one is required"):
        check_routes(router)
