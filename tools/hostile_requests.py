"""Requests that no browser sends, byte for byte, and what every answer to them must be. SECURITY.md lists their classes."""

from __future__ import annotations

import contextlib
import re
import socket
import ssl

STATUS = re.compile(rb"HTTP/1\.[01] (\d{3}) ")
SECRETS = (b"root:", b"SQLite format", b"[project]", b"PRIVATE KEY")
"""First bytes of files that the server must not publish."""
MAX_ANSWER_BYTES = 1 << 20
ANSWER_S, QUIET_S = 30.0, 1.0
"""Time for the first byte of an answer, and silence after which it is complete. The client does not close its direction: the
server would then discard an answer that is not yet sent."""
HOST = b"Host: localhost\r\n"
PLAIN = HOST + b"Connection: close\r\n\r\n"


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
FRAMING = {f"smuggling: {name}": request for name, request in SMUGGLING.items()} | OTHERS
"""Requests whose end or recipient servers can judge differently."""
UNANSWERED = ("HTTP/0.9",)
"""Requests without an end. The server closes their connections after a time."""
REQUESTS = (
    {f"traversal {path.decode()}": get(path) for path in TRAVERSAL}
    | {f"injection {path.decode()}": get(path) for path in INJECTION}
    | FRAMING
    | FLOODS
)


def answers(
    address: tuple[str, int], request: bytes, tls: ssl.SSLContext | None = None, source: str = "127.0.0.1"
) -> bytes:
    """Return everything that a server sends until it closes the connection or is silent. ``source``: address of the
    client."""
    received = b""
    with contextlib.ExitStack() as stack, contextlib.suppress(OSError):
        line = stack.enter_context(socket.create_connection(address, ANSWER_S, (source, 0)))
        if tls is not None:
            line = stack.enter_context(tls.wrap_socket(line, server_hostname="localhost"))
        with contextlib.suppress(OSError):  # the server may close the connection before it has read everything
            line.sendall(request)
        while len(received) < MAX_ANSWER_BYTES and (data := line.recv(65536)):
            received += data
            line.settimeout(QUIET_S)
    return received


def statuses(received: bytes) -> list[int]:
    """Return the status of every response."""
    return [int(code) for code in STATUS.findall(received)]


def check_harmless(name: str, received: bytes, *, allowed: tuple[int, ...] = (), several: bool = False) -> None:
    """Check that an answer has no file of the host, no injected header, no second request, no other protocol and no failure.
    ``allowed``: accepted statuses from 500. ``several``: the request ends where the next one begins.
    """
    codes = statuses(received)
    head = received.partition(b"\r\n\r\n")[0].lower()
    problems = [
        *(f"status {code}" for code in codes if code == 101 or (code >= 500 and code not in allowed)),
        *(f"content {secret!r}" for secret in SECRETS if secret in received),
        *(f"header {word!r}" for word in (b"x-injected", b"evil.example") if word in head),
        *(["two responses"] if name.startswith("smuggling") and len(codes) > 1 and not several else []),
    ]
    if problems:
        raise AssertionError(f"{name}: {', '.join(problems)}: {received[:800]!r}")
