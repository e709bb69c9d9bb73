"""Requests that no browser sends, byte for byte, against a real server: traversal, header injection, smuggling, floods of bytes.

SECURITY.md lists these classes with the date of the last run.
"""

from __future__ import annotations

import contextlib
import re
import socket
from collections.abc import Iterator

import httpx2
import pytest

from tools.served import Served, served

pytestmark = pytest.mark.timeout(240)
HOST = b"Host: localhost\r\n"
PLAIN = HOST + b"Connection: close\r\n\r\n"
STATUS = re.compile(rb"HTTP/1\.[01] (\d{3}) ")
SECRETS = (b"root:", b"SQLite format", b"[project]", b"PRIVATE KEY")
"""First bytes of files that the server must not publish."""
MAX_ANSWER_BYTES = 1 << 20
QUIET_S = 20.0


def get(path: bytes, more: bytes = PLAIN) -> bytes:
    """Return a GET request."""
    return b"GET " + path + b" HTTP/1.1\r\n" + more


def post(more: bytes, body: bytes = b"", path: bytes = b"/api/session") -> bytes:
    """Return a POST request to a route without sign-in."""
    return (
        b"POST "
        + path
        + b" HTTP/1.1\r\n"
        + HOST
        + b"X-GSS: 1\r\nContent-Type: application/json\r\n"
        + more
        + b"\r\n"
        + body
    )


TRAVERSAL = [
    b"/../../../../../../etc/passwd",
    b"/assets/../../../../../../etc/passwd",
    b"/assets/..%2f..%2f..%2f..%2f..%2fetc%2fpasswd",
    b"/assets/%2e%2e/%2e%2e/%2e%2e/etc/passwd",
    b"/assets/..%252f..%252f..%252fetc%252fpasswd",
    b"/assets/..%c0%af..%c0%afetc/passwd",
    b"/assets/..\\..\\..\\etc\\passwd",
    b"/assets//etc/passwd",
    b"/assets/index.js%00.html",
    b"//etc/passwd",
    b"/help/../../pyproject.toml",
    b"/help/..%2f..%2fpyproject",
    b"/api/rerun/viewer/..%2f..%2f..%2fgss.db",
    b"/api/contacts/captures/..%2f..%2fgss.db",
    b"/api/admin/backups/..%2f..%2fgss.db",
    b"file:///etc/passwd",
    b"http://localhost/../../etc/passwd",
    b"http://169.254.169.254/latest/meta-data/",
]
INJECTION = [
    b"/api/frames?sort=%0d%0aX-Injected:%20yes%0d%0a",
    b"/live%0d%0aX-Injected:%20yes",
    b"/live%0aX-Injected:%20yes",
    b"/%e5%98%8a%e5%98%8dX-Injected:%20yes",
    b"/api/audit/export?format=csv%0d%0aX-Injected:%20yes",
    b"//evil.example/%2f..",
    b"/\\evil.example",
]
SMUGGLED = b"GET /api/smuggled-request HTTP/1.1\r\n" + HOST + b"\r\n"
SMUGGLING = {
    "length and chunks": post(b"Content-Length: 4\r\nTransfer-Encoding: chunked\r\n", b"0\r\n\r\n" + SMUGGLED),
    "chunks and length": post(b"Transfer-Encoding: chunked\r\nContent-Length: 4\r\n", b"0\r\n\r\n" + SMUGGLED),
    "two lengths": post(b"Content-Length: 0\r\nContent-Length: 70\r\n", SMUGGLED),
    "negative length": post(b"Content-Length: -1\r\n", SMUGGLED),
    "signed length": post(b"Content-Length: +0\r\n", SMUGGLED),
    "length in hexadecimal": post(b"Content-Length: 0x00\r\n", SMUGGLED),
    "list of lengths": post(b"Content-Length: 0, 70\r\n", SMUGGLED),
    "unknown coding": post(b"Transfer-Encoding: xchunked\r\nContent-Length: 0\r\n", SMUGGLED),
    "coding twice": post(b"Transfer-Encoding: chunked\r\nTransfer-Encoding: identity\r\n", b"0\r\n\r\n" + SMUGGLED),
    "space before the colon": post(b"Transfer-Encoding : chunked\r\nContent-Length: 0\r\n", SMUGGLED),
    "chunk size beyond 64 bits": post(b"Transfer-Encoding: chunked\r\n", b"1" + b"0" * 16 + b"\r\n" + SMUGGLED),
    "chunk size with a sign": post(b"Transfer-Encoding: chunked\r\n", b"-1\r\n" + SMUGGLED),
}
FLOODS = {
    "request line of 200 kB": get(b"/" + b"a" * 200_000),
    "query of 200 kB": get(b"/api/frames?name=" + b"a" * 200_000),
    "header of 1 MB": get(b"/live", HOST + b"X-A: " + b"a" * (1 << 20) + b"\r\n\r\n"),
    "100 000 headers": get(b"/live", HOST + b"X-A: b\r\n" * 100_000 + b"\r\n"),
    "cookie of 60 kB": get(
        b"/api/session", HOST + b"Cookie: gss_session=" + b"a" * 60_000 + b"\r\nConnection: close\r\n\r\n"
    ),
    "bearer token of 60 kB": get(b"/api/frames", HOST + b"Authorization: Bearer " + b"a" * 60_000 + b"\r\n\r\n"),
    "body of 10 GB announced": post(b"Content-Length: 10737418240\r\n", b"{" * 10_000),
    "body of 2 MB to the sign-in": post(b"Content-Length: 2097152\r\n", b" " * 2_097_152),
    "chunked body": post(b"Transfer-Encoding: chunked\r\n", b"400\r\n" + b" " * 1024 + b"\r\n0\r\n\r\n"),
    "nested JSON": post(b"Content-Length: 60000\r\n", b"[" * 60_000),
}
OTHERS = {
    "bare line feeds": b"POST /api/session HTTP/1.1\nHost: localhost\nContent-Length: 0\n\n" + SMUGGLED,
    "folded header": post(b"X-A: b\r\n Transfer-Encoding: chunked\r\nContent-Length: 0\r\n", SMUGGLED),
    "no host": b"GET /api/health HTTP/1.1\r\n\r\n",
    "two hosts": get(b"/api/health", HOST + b"Host: evil.example\r\n\r\n"),
    "another host": get(b"/api/health", b"Host: evil.example\r\n\r\n"),
    "host with a path": get(b"/api/health", b"Host: localhost/../x@evil.example\r\n\r\n"),
    "TRACE": b"TRACE /api/session HTTP/1.1\r\n" + PLAIN,
    "CONNECT": b"CONNECT 127.0.0.1:22 HTTP/1.1\r\n" + PLAIN,
    "an unknown method": b"GSS / HTTP/1.1\r\n" + PLAIN,
    "HTTP/0.9": b"GET /\r\n",
    "HTTP/9.9": b"GET / HTTP/9.9\r\n" + PLAIN,
    "HTTP/2 preface": b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n" + bytes(27),
    "TLS": bytes.fromhex("1603010200010001fc0303") + bytes(500),
    "zeros": bytes(10_000),
    "WebSocket": get(
        b"/api/stream",
        HOST + b"Upgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Version: 13\r\n"
        b"Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n\r\n",
    ),
    "HTTP/2 upgrade": get(
        b"/live", HOST + b"Connection: Upgrade, HTTP2-Settings\r\nUpgrade: h2c\r\nHTTP2-Settings: AAMAAABk\r\n\r\n"
    ),
    "bytes beyond ASCII": get(b"/\xff\xfe\xfd", HOST + b"X-\xff: \xff\r\n\r\n"),
    "method override": post(b"X-HTTP-Method-Override: DELETE\r\nContent-Length: 2\r\n", b"{}", b"/api/users/1"),
    "foreign origin": post(b"Origin: https://evil.example\r\nContent-Length: 2\r\n", b"{}"),
    "null origin": post(b"Origin: null\r\nContent-Length: 2\r\n", b"{}"),
}
REQUESTS = (
    {f"traversal {path.decode()}": get(path) for path in TRAVERSAL}
    | {f"injection {path.decode()}": get(path) for path in INJECTION}
    | {f"smuggling: {name}": request for name, request in SMUGGLING.items()}
    | FLOODS
    | OTHERS
)


@pytest.fixture(scope="module", params=[(), ("--workers", "1")], ids=["one process", "a worker"])
def server(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    """Server that receives all requests of this file."""
    with served(tmp_path_factory.mktemp("attacked") / "data", *request.param) as server:
        yield server


def answers(server: Served, request: bytes) -> bytes:
    """Return everything that the server sends until it closes the connection or is silent."""
    received = b""
    with socket.create_connection(server.host_and_port, timeout=QUIET_S) as line, contextlib.suppress(OSError):
        with contextlib.suppress(OSError):  # the server may close the connection before it has read everything
            line.sendall(request)
            line.shutdown(socket.SHUT_WR)
        while len(received) < MAX_ANSWER_BYTES and (data := line.recv(65536)):
            received += data
    return received


@pytest.mark.parametrize("name", REQUESTS)
def test_a_hostile_request_is_rejected_or_harmless(server: Served, name: str) -> None:
    """The response contains no file of the host and no injected header. No second request and no other protocol
    is served.
    """
    received = answers(server, REQUESTS[name])
    statuses = [int(code) for code in STATUS.findall(received)]
    assert not [code for code in statuses if code >= 500], received[:500]
    assert not any(secret in received for secret in SECRETS), received[:500]
    head = received.partition(b"\r\n\r\n")[0].lower()
    assert b"x-injected" not in head
    assert b"evil.example" not in head
    assert 101 not in statuses
    if name.startswith("smuggling"):
        assert len(statuses) <= 1, received[:800]
    if statuses and statuses[0] < 300:
        assert b"content-security-policy" in head


def test_the_server_still_works_afterwards(server: Served) -> None:
    """After all requests the server answers an admin and ABORT, and its log has no traceback."""
    with httpx2.Client(base_url=f"{server.address}/api", headers=server.headers, timeout=30) as client:
        assert client.get("/link").status_code == 200
        assert client.post("/commands/abort").status_code == 409
        assert client.get("/audit/verify").json()["problem"] == ""
    log = (server.folder.parent / f"{server.folder.name}.log").read_text(errors="replace")
    assert "Traceback" not in log, log[-3000:]
