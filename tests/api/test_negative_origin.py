"""Origins of requests: other sites, DNS rebinding, untrusted proxies, redirects, and the event stream."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from fastapi import FastAPI
from fastapi.testclient import TestClient
from starlette.datastructures import Headers

from gss.api.app import create_app
from gss.api.connections.admission import ConnectionLimits, Connections
from gss.api.guard.perimeter import Caller, Perimeter, host_name
from gss.api.serving import address_of, greeting, uvicorn_options
from gss.api.stream import route as stream
from gss.operations.accounts.users import Link
from gss.operations.clock import utc_now
from gss.settings import Settings
from gss.store.audit import AuditFilter
from gss.wiring.build import build

PROXY = {"behind_proxy": True, "public_names": "gss.example.org", "trusted_proxies": "192.0.2.7,10.0.0.0/8"}


@pytest.fixture(scope="module")
def proxied(tmp_path_factory: pytest.TempPathFactory) -> FastAPI:
    """Server behind a proxy. It is not started, because these tests need none of its threads."""
    folder: Path = tmp_path_factory.mktemp("proxied")
    return create_app(build(Settings(data=folder, **PROXY)))


@pytest.fixture(scope="module")
def headers(app: FastAPI, signed_in: Callable[..., dict[str, str]]) -> dict[str, str]:
    """Request headers of a signed-in admin."""
    return signed_in(app.state.services)


def browser(app: FastAPI, host: str = "http://localhost", peer: str = "127.0.0.1") -> TestClient:
    """Return a client at a network address."""
    return TestClient(app, base_url=host, raise_server_exceptions=False, client=(peer, 4000))


@pytest.mark.parametrize(
    "foreign",
    [
        {"Origin": "https://evil.example"},
        {"Origin": "http://localhost.evil.example"},
        {"Origin": "http://localhost:9999"},
        {"Origin": "https://localhost"},
        {"Origin": "null"},
        {"Origin": ""},
        {"Origin": "http://[::1"},
        {"Sec-Fetch-Site": "cross-site"},
        {"Sec-Fetch-Site": "same-site"},
        {"Sec-Fetch-Site": "anything"},
        {"Host": "evil.example"},
        {"Host": "localhost.evil.example"},
        {"Host": "127.0.0.1.nip.io"},
        {"Host": "169.254.169.254"},
        {"Host": ""},
    ],
)
@pytest.mark.parametrize("path", ["/api/link", "/api/stream", "/api/session", "/api/rerun/re_viewer.js", "/metrics"])
def test_a_foreign_page_gets_nothing_even_with_a_cookie(
    app: FastAPI, headers: dict[str, str], foreign: dict[str, str], path: str
) -> None:
    """Requests of other sites, other ports of the host, sandboxed frames and rebound names are rejected on every
    route.
    """
    reply = browser(app).get(path, headers=headers | foreign)
    assert reply.status_code == 403, reply.text
    assert "access-control-allow-origin" not in reply.headers


@pytest.mark.parametrize(
    "foreign",
    [{"Origin": "https://evil.example"}, {"Origin": "http://localhost:9999"}, {"Sec-Fetch-Site": "same-site"}],
)
def test_a_foreign_page_changes_nothing_even_with_cookie_and_token(
    app: FastAPI, headers: dict[str, str], foreign: dict[str, str]
) -> None:
    """A page of another origin cannot change data and cannot sign a user in (login CSRF)."""
    assert browser(app).post("/api/authority/take", headers=headers | foreign).status_code == 403
    reply = browser(app).post("/api/session", json={"name": "x", "password": "y"}, headers={"X-GSS": "1"} | foreign)
    assert reply.status_code == 403
    assert app.state.services.commanding.authority.holder() is None


def test_a_plain_form_of_another_site_is_rejected(app: FastAPI, headers: dict[str, str]) -> None:
    """A form cannot send the CSRF header without a preflight, and the server accepts no preflight."""
    cookie = {"Cookie": headers["Cookie"]}
    form = {"Content-Type": "text/plain"}
    assert browser(app).post("/api/authority/take", headers=cookie | form, content=b"{}").status_code == 403
    assert browser(app).post("/api/session", headers=form, content=b'{"name":"a","password":"b"}').status_code == 403
    preflight = {"Origin": "https://evil.example", "Access-Control-Request-Method": "POST"}
    reply = browser(app).options("/api/authority/take", headers=cookie | preflight)
    assert reply.status_code == 403
    assert not [name for name in reply.headers if name.startswith("access-control")]


def test_our_own_page_is_accepted_and_a_foreign_link_opens_the_page_only(app: FastAPI, headers: dict[str, str]) -> None:
    """Changes need the same origin. Links of other sites may open the page, which contains no data."""
    same_origin = {"Origin": "http://localhost", "Sec-Fetch-Site": "same-origin"}
    assert browser(app).post("/api/authority/take", headers=headers | same_origin).status_code == 200
    assert browser(app).post("/api/authority/release", headers=headers | same_origin).status_code == 200
    assert browser(app).get("/", headers={"Sec-Fetch-Site": "cross-site"}).status_code == 200
    assert browser(app).post("/", headers=headers).status_code == 405


@pytest.mark.parametrize("header", ["X-Forwarded-For", "Forwarded", "X-Real-IP", "X-Client-IP"])
def test_a_client_cannot_write_another_address_into_the_record(app: FastAPI, header: str) -> None:
    """Without a proxy, forwarding headers affect neither the audit log nor the rate limits."""
    client = browser(app, peer="203.0.113.9")
    codes = []
    for k in range(20):
        spoofed = {"X-GSS": "1", header: f"198.51.100.{k}"}
        codes.append(
            client.post("/api/session", json={"name": "unknown", "password": "guess"}, headers=spoofed).status_code
        )
    assert codes[-1] == 429
    rows = app.state.services.accounts.audit.page(AuditFilter(action="session.sign_in"), 20)
    assert {row.address for row in rows} == {"203.0.113.9"}
    app.state.services.accounts.accounts.attempts._failures.clear()


def test_behind_a_proxy_only_the_proxy_is_accepted(proxied: FastAPI) -> None:
    """Requests that bypass the proxy, use plain HTTP or another name are rejected. Health is open for monitoring."""
    valid = {"X-Forwarded-Proto": "https", "X-Forwarded-For": "203.0.113.5", "Host": "gss.example.org"}
    proxy = browser(proxied, peer="192.0.2.7")
    assert proxy.get("/api/session", headers=valid).status_code == 200
    assert browser(proxied, peer="203.0.113.5").get("/api/session", headers=valid).status_code == 403
    assert proxy.get("/api/session", headers=valid | {"X-Forwarded-Proto": "http"}).status_code == 403
    assert proxy.get("/api/session", headers={"Host": "gss.example.org"}).status_code == 403
    assert proxy.get("/api/session", headers=valid | {"Host": "evil.example"}).status_code == 403
    assert proxy.get("/api/session", headers=valid | {"X-Forwarded-Host": "evil.example"}).status_code == 403
    assert proxy.get("/api/session", headers=valid | {"Origin": "https://gss.example.org"}).status_code == 200
    assert proxy.get("/api/session", headers=valid | {"Origin": "http://gss.example.org"}).status_code == 403
    assert browser(proxied, peer="127.0.0.1").get("/api/health").json() == {"status": "ok"}


def test_behind_a_proxy_the_last_untrusted_address_of_the_list_is_the_caller(proxied: FastAPI) -> None:
    """The audit log has the last address that is not a trusted proxy, because earlier entries may be forged."""
    head = {"X-Forwarded-Proto": "https", "Host": "gss.example.org", "X-GSS": "1"}
    for forwarded, address in (
        ("203.0.113.5", "203.0.113.5"),
        ("127.0.0.1, 203.0.113.6", "203.0.113.6"),
        ("1.2.3.4, 203.0.113.7, 10.1.2.3", "203.0.113.7"),
        ("198.51.100.1, <script>", "-"),
        ("", "192.0.2.7"),
    ):
        spoofed = head | {"X-Forwarded-For": forwarded}
        body = {"name": "unknown", "password": "guess"}
        reply = browser(proxied, peer="192.0.2.7").post("/api/session", json=body, headers=spoofed)
        assert reply.status_code == 401
        assert proxied.state.services.accounts.audit.page(AuditFilter(), 1)[0].address == address


def test_of_several_forwarded_lines_the_last_one_counts() -> None:
    """If a proxy adds a separate header line, earlier lines of the client are ignored."""
    perimeter = Perimeter(Settings(**PROXY))
    lines = [
        ("x-forwarded-proto", "https"),
        ("x-forwarded-for", "1.2.3.4"),
        ("x-forwarded-for", "203.0.113.8, 10.1.1.1"),
    ]
    lines += [("x-forwarded-host", "evil.example"), ("x-forwarded-host", "gss.example.org")]
    headers = Headers(raw=[(name.encode(), value.encode()) for name, value in lines])
    caller = perimeter.caller({"type": "http", "client": ("192.0.2.7", 1)}, headers)
    assert caller == Caller("203.0.113.8", "gss.example.org", True)


@pytest.mark.parametrize(
    ("authority", "name"),
    [
        ("localhost", "localhost"),
        ("LOCALHOST:8181", "localhost"),
        ("[::1]:8181", "::1"),
        ("localhost/../x@evil.example", ""),
        ("localhost?x", ""),
        ("evil.example@localhost", ""),
        ("localhost:x", ""),
        ("localhost:99999", ""),
        ("[::1", ""),
    ],
)
def test_a_host_is_a_name_with_or_without_a_port(authority: str, name: str) -> None:
    """A Host with a path, a query, a user name or an invalid port is rejected."""
    assert host_name(authority) == name


def test_with_tls_cookies_are_secure_and_browsers_stay_with_it(proxied: FastAPI) -> None:
    """Behind a proxy the server sets a secure cookie and sends HSTS."""
    users = proxied.state.services.accounts.accounts.users
    link = users.password_link(users.add("ann", "admin", by="test").id, by="test")
    head = {"X-Forwarded-Proto": "https", "Host": "gss.example.org", "X-GSS": "1"}
    body = {"token": link.key, "password": "orion over the sea"}
    reply = browser(proxied, peer="10.0.0.1").post("/api/password-links", json=body, headers=head)
    assert reply.status_code == 200
    assert "Secure" in reply.headers["set-cookie"]
    assert reply.headers["strict-transport-security"] == "max-age=31536000"


def test_the_plain_server_sends_no_hsts(app: FastAPI) -> None:
    """A server without TLS sends no HSTS, which would lock browsers out of localhost."""
    assert "strict-transport-security" not in browser(app).get("/api/session").headers


def test_the_start_prints_one_address() -> None:
    """The greeting has the address that browsers use, with a setup link while there is no user."""
    link = Link("KEY", utc_now())
    assert greeting(Settings(), 8181, None) == "GSS is at http://127.0.0.1:8181"
    assert greeting(Settings(), 8181, link).endswith("http://127.0.0.1:8181/setup#KEY")
    assert address_of(Settings(**PROXY), 8181) == "https://gss.example.org"
    tls = Settings(host="::", tls_certificate="c", tls_key="k", public_names="gss.example.org")
    assert address_of(tls, 8443) == "https://gss.example.org:8443"
    assert address_of(Settings(host="::1"), 8181) == "http://[::1]:8181"
    options = uvicorn_options(tls, Connections(ConnectionLimits(1, 1, 1)))
    assert options.items() >= {
        ("ws", "none"),
        ("proxy_headers", False),
        ("server_header", False),
        ("ssl_certfile", "c"),
        ("ssl_keyfile", "k"),
    }


@pytest.mark.parametrize("path", ["//evil.example", "/\\evil.example", "/%2F%2Fevil.example", "/https://evil.example/"])
def test_no_response_redirects_to_another_host(app: FastAPI, path: str) -> None:
    """No response redirects to another host."""
    reply = browser(app).get(f"http://localhost{path}", follow_redirects=False)
    target = reply.headers.get("location", "")
    assert not target.startswith(("//", "/\\", "http")) or target.startswith("http://localhost/")


def test_there_is_no_websocket(app: FastAPI, headers: dict[str, str]) -> None:
    """The server rejects WebSocket connections."""
    from starlette.websockets import WebSocketDisconnect

    with pytest.raises(WebSocketDisconnect), browser(app).websocket_connect("/api/stream", headers=headers):
        pass


class StreamListener:
    """ASGI request of a subscriber to the event stream."""

    def __init__(self, app: FastAPI, headers: dict[str, str]) -> None:
        self.app, self.body, self.status, self.gone = app, b"", 0, asyncio.Event()
        self.headers = [(b"host", b"localhost"), *((k.lower().encode(), v.encode()) for k, v in headers.items())]

    async def listen(self) -> None:
        """Receive events until the server ends the stream."""
        scope = {
            "type": "http",
            "asgi": {"version": "3.0"},
            "http_version": "1.1",
            "method": "GET",
            "scheme": "http",
            "path": "/api/stream",
            "raw_path": b"/api/stream",
            "query_string": b"",
            "root_path": "",
            "headers": self.headers,
            "client": ("127.0.0.1", 1),
            "server": ("localhost", 80),
        }
        await self.app(scope, self._receive, self._send)

    async def _receive(self) -> dict[str, Any]:
        await self.gone.wait()
        return {"type": "http.disconnect"}

    async def _send(self, message: dict[str, Any]) -> None:
        self.status = message.get("status", self.status)
        self.body += message.get("body", b"")


@pytest.mark.parametrize("cause", ["ended", "switched off", "password", "token"])
def test_a_stream_ends_with_the_session_that_opened_it(
    app: FastAPI, signed_in: Any, monkeypatch: pytest.MonkeyPatch, cause: str
) -> None:
    """The server ends a stream when its session ends, its user is disabled, the password changes or its token is
    revoked.
    """
    monkeypatch.setattr(stream, "RECHECK_S", 0.02)
    accounts = app.state.services.accounts.accounts
    name = f"listener {cause}"
    headers = signed_in(app.state.services, "operator", name)
    token = accounts.tokens.add(name, "viewer", 1, by="test")
    if cause == "token":
        headers = {"Authorization": f"Bearer {token.key}"}
    user = accounts.users.named(name)

    def end() -> None:
        if cause == "ended":
            session = next(row for row, owner in accounts.sessions.active() if owner.name == name)
            accounts.sessions.end(session.id, by="test")
        elif cause == "switched off":
            accounts.users.change(user.id, enabled=False)
        elif cause == "password":
            accounts.users.set_password(user.id, "orion over the sea")
        else:
            accounts.tokens.revoke(token.row.id)

    async def run() -> StreamListener:
        listener = StreamListener(app, headers)
        task = asyncio.create_task(listener.listen())
        for _ in range(1000):
            await asyncio.sleep(0.01)
            if b"event: link" in listener.body:
                break
        assert not task.done(), listener.body[-300:]
        await asyncio.to_thread(end)
        await asyncio.wait_for(task, 20)
        return listener

    listener = asyncio.run(run())
    assert listener.status == 200
    last = listener.body.decode().strip().split("\n\n")[-1]
    assert "event: session" in last
    assert json.loads(last.split("data: ")[1].splitlines()[0])["ended"]
