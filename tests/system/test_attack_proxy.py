"""The shipped nginx and Caddy files under attack, with the real programs in front of a real server.

Both proxies end TLS with the configuration in ``deploy/``, of which only addresses and files are replaced.
"""

from __future__ import annotations

import contextlib
import os
import re
import socket
import ssl
import struct
import subprocess
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import httpx2
import pytest

from tools.hostile_requests import FRAMING, HOST, PLAIN, UNANSWERED, answers, check_harmless, get, statuses
from tools.served import Served, served

pytestmark = [pytest.mark.proxies, pytest.mark.timeout(400)]
ROOT = Path(__file__).parents[2]
FRONTS = ("nginx", "caddy")
STREAMS = 3
"""Streams that a user may have."""
OUTSIDE = "127.0.0.9"
"""Address of clients that are not on the proxy's host."""
REFUSED_BY_FRONT = (501, 502, 505)
"""Answers of a proxy to an unknown transfer coding, an invalid chunk or an unknown protocol version."""
THROUGH = [name for name in FRAMING if name not in ("TLS", "zeros", *UNANSWERED)]
"""Requests of the test. Caddy waits without a limit for the end of the others."""
FROM_SERVER = b"content-security-policy"
"""Header of every answer that the server itself gave."""
BOTH_SERVED = {"caddy": ("length and chunks", "chunks and length")}
"""Caddy uses the chunks and ignores the length. It forwards the bytes after the chunks as the next request of the same client."""
UNFORGED = get(b"/api/session", b"X-Forwarded-Proto: https\r\n" + PLAIN)
FORGED = {
    "host": b"X-Forwarded-Proto: https\r\nX-Forwarded-Host: evil.example\r\n",
    "last host of a list": b"X-Forwarded-Proto: https\r\nX-Forwarded-Host: localhost, evil.example\r\n",
    "host with a path": b"X-Forwarded-Proto: https\r\nX-Forwarded-Host: localhost/../@evil.example\r\n",
    "second scheme": b"X-Forwarded-Proto: https\r\nX-Forwarded-Proto: http\r\n",
    "no scheme": b"",
    "scheme with a host": b"X-Forwarded-Proto: HTTPS://evil.example\r\n",
    "Forwarded": b"Forwarded: for=127.0.0.1;host=evil.example;proto=https\r\n",
    "origin": b"X-Forwarded-Proto: https\r\nOrigin: https://evil.example\r\n",
    "origin without TLS": b"X-Forwarded-Proto: https\r\nOrigin: http://localhost\r\n",
}
"""Header lines that a careless proxy would copy from its client. The server refuses each request."""
IGNORED = {
    "addresses": b"X-Forwarded-For: 127.0.0.1, ::1, <b>, 999.1.1.1\r\n",
    "first host of a list": b"X-Forwarded-Host: evil.example, localhost\r\n",
    "prefix": b"X-Forwarded-Prefix: //evil.example\r\nX-Forwarded-Port: 1\r\nX-Forwarded-Server: evil.example\r\n",
    "other path": b"X-Original-URL: /api/users\r\nX-Rewrite-URL: /api/users\r\n",
    "address of the client": b"X-Real-IP: 127.0.0.1\r\nX-Client-IP: 127.0.0.1\r\nTrue-Client-IP: 127.0.0.1\r\n",
}
"""Header lines that the server ignores, or of which it uses only the last value."""


@dataclass(frozen=True)
class Site:
    """A server behind two proxies. ``ports``: HTTPS port of each proxy; ``plain_port``: HTTP port of nginx."""

    server: Served
    address: tuple[str, int]
    trust: ssl.SSLContext
    ports: dict[str, int]
    plain_port: int

    def ask(self, front: str, request: bytes, source: str = OUTSIDE) -> bytes:
        """Send bytes through a proxy and return the answer."""
        return answers(("127.0.0.1", self.ports[front]), request, self.trust, source)

    def connect(self, front: str) -> ssl.SSLSocket:
        """Return a connection to a proxy after the handshake."""
        line = socket.create_connection(("127.0.0.1", self.ports[front]), 30)
        return self.trust.wrap_socket(line, server_hostname="localhost")


@pytest.fixture(scope="module")
def site(certificate: Any, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Site]:
    folder = tmp_path_factory.mktemp("proxies")
    with contextlib.ExitStack() as probes:
        lines = [probes.enter_context(socket.create_server(("127.0.0.1", 0))) for _ in range(4)]
        server_port, nginx_port, plain_port, caddy_port = (line.getsockname()[1] for line in lines)
    files = write_files(folder, certificate, server_port, nginx_port, plain_port, caddy_port)
    settings = {"GSS_BEHIND_PROXY": "1", "GSS_PUBLIC_NAMES": "localhost", "GSS_TRUSTED_PROXIES": "127.0.0.1"}
    commands = (
        ["nginx", "-p", str(folder), "-c", str(files["nginx"])],
        ["caddy", "run", "--adapter", "caddyfile", "--config", str(files["caddy"])],
    )
    environment = {**os.environ, "HOME": str(folder), "XDG_DATA_HOME": str(folder), "XDG_CONFIG_HOME": str(folder)}
    with served(folder / "data", "--port", str(server_port), GSS_STREAMS_EACH=str(STREAMS), **settings) as server:
        log = (folder / "proxies.log").open("wb")
        processes = [subprocess.Popen(command, stderr=log, stdout=log, env=environment) for command in commands]
        ports = {"nginx": nginx_port, "caddy": caddy_port}
        site = Site(server, ("127.0.0.1", server_port), certificate.trust, ports, plain_port)
        try:
            for port in ports.values():
                wait_for(port)
            yield site
        finally:
            for process in processes:
                process.terminate()
                process.wait(30)
            log.close()


def write_files(
    folder: Path, certificate: Any, server_port: int, nginx_port: int, plain_port: int, caddy_port: int
) -> dict[str, Path]:
    """Write the shipped files with addresses and certificate of this test. Every replaced text must exist."""
    text = (ROOT / "deploy" / "nginx.conf").read_text()
    for old, new in (
        ("127.0.0.1:8181", f"127.0.0.1:{server_port}"),
        ("listen 80;", f"listen 127.0.0.1:{plain_port};"),
        ("listen [::]:80;", ""),
        ("listen 443 ssl http2;", f"listen 127.0.0.1:{nginx_port} ssl http2;"),
        ("listen [::]:443 ssl http2;", ""),
        ("/etc/gss/certificate.pem", str(certificate.chain)),
        ("/etc/gss/key.pem", str(certificate.key)),
        ("gss.example.org", "localhost"),
    ):
        assert old in text
        text = text.replace(old, new)
    kinds = ("client_body", "proxy", "fastcgi", "uwsgi", "scgi")
    paths = "".join(f"{kind}_temp_path {folder}/{kind};" for kind in kinds)
    user = "user root;" if os.geteuid() == 0 else ""
    nginx = f"{user} daemon off; pid {folder}/nginx.pid; error_log stderr; worker_processes 1; events {{}}"
    (folder / "nginx.conf").write_text(f"{nginx}\nhttp {{ access_log off; {paths}\n{text}\n}}\n")
    text = (ROOT / "deploy" / "Caddyfile").read_text()
    assert "127.0.0.1:8181" in text
    site = f"https://localhost:{caddy_port} {{\n\ttls {certificate.chain} {certificate.key}"
    text, count = re.subn(r"(?m)^gss\.example\.org \{", site, text.replace(":8181", f":{server_port}"))
    assert count == 1
    (folder / "Caddyfile").write_text(f"{{\n\tadmin off\n\tauto_https disable_redirects\n}}\n{text}")
    return {"nginx": folder / "nginx.conf", "caddy": folder / "Caddyfile"}


def wait_for(port: int) -> None:
    """Wait until a program listens on a port."""
    limit_s = time.monotonic() + 60
    while True:
        try:
            socket.create_connection(("127.0.0.1", port), 5).close()
            return
        except OSError:
            if time.monotonic() > limit_s:
                raise
            time.sleep(0.1)


@pytest.mark.parametrize("front", FRONTS)
@pytest.mark.parametrize("name", THROUGH)
def test_a_hostile_request_through_a_proxy_is_rejected_or_harmless(site: Site, front: str, name: str) -> None:
    """No answer contains a second response or another protocol. Afterwards the next client of the proxy gets the answer to
    its own request, so no bytes remained on the connection between proxy and server.
    """
    received = site.ask(front, FRAMING[name])
    by_front = REFUSED_BY_FRONT if FROM_SERVER not in received.lower() else ()
    several = name.removeprefix("smuggling: ") in BOTH_SERVED.get(front, ())
    check_harmless(name, received, allowed=by_front, several=several)
    next_client = site.ask(front, get(b"/api/session"), "127.0.0.10")
    assert statuses(next_client) == [200], (received[:500], next_client[:500])
    assert b"smuggled" not in next_client


@pytest.mark.parametrize("front", FRONTS)
@pytest.mark.parametrize("name", [*FORGED, *IGNORED])
def test_a_proxy_replaces_forged_headers(site: Site, front: str, name: str) -> None:
    """Forwarding headers of a client change nothing; only a foreign Origin is refused."""
    lines = (FORGED | IGNORED)[name]
    code = 403 if b"Origin: " in lines else 200
    assert statuses(site.ask(front, get(b"/api/session", lines + PLAIN))) == [code]


@pytest.mark.parametrize("front", FRONTS)
def test_the_audit_log_has_the_address_of_the_client(site: Site, front: str) -> None:
    """A failed sign-in is recorded with the address of the proxy's client, not with one that the client states."""
    stated = b"X-Forwarded-For: 198.51.100.7\r\nForwarded: for=198.51.100.7\r\nX-Real-IP: 198.51.100.7\r\n"
    client = f"127.0.0.{20 + FRONTS.index(front)}"
    body = b'{"name":"unknown","password":"a guess of a word"}'
    length = f"Content-Length: {len(body)}\r\nX-GSS: 1\r\nContent-Type: application/json\r\n".encode()
    attempt = b"POST /api/session HTTP/1.1\r\n" + stated + length + PLAIN + body
    assert statuses(site.ask(front, attempt, client)) == [401]
    url = f"https://localhost:{site.ports[front]}/api/audit"
    addresses: set[str] = set()
    deadline_s = time.monotonic() + 30
    while client not in addresses:  # the row is written after the answer
        assert time.monotonic() < deadline_s, addresses
        rows = httpx2.get(url, params={"action": "session.sign_in"}, headers=site.server.headers, verify=site.trust)
        addresses = {row["address"] for row in rows.json()}
    assert "198.51.100.7" not in addresses


@pytest.mark.parametrize("name", FORGED)
def test_a_proxy_that_copies_forged_headers_is_refused(site: Site, name: str) -> None:
    """The server refuses the request of a trusted address that is not HTTPS, or has another host or origin."""
    request = get(b"/api/session", FORGED[name] + PLAIN)
    assert statuses(answers(site.address, request)) == [403]


@pytest.mark.parametrize("name", IGNORED)
def test_other_forged_headers_change_no_answer(site: Site, name: str) -> None:
    """The answer is that of a request without these headers."""
    received = answers(site.address, get(b"/api/session", b"X-Forwarded-Proto: https\r\n" + IGNORED[name] + PLAIN))
    unforged = answers(site.address, UNFORGED)
    assert statuses(received) == [200]
    assert received.partition(b"\r\n\r\n")[2] == unforged.partition(b"\r\n\r\n")[2]


def test_only_the_address_of_the_proxy_is_trusted(site: Site) -> None:
    """Another address with the headers of the proxy and an admin's token is refused; the proxy is served."""
    token = f"Authorization: {site.server.headers['Authorization']}\r\n".encode()
    forwarded = b"X-Forwarded-Proto: https\r\nX-Forwarded-For: 127.0.0.1\r\nX-Forwarded-Host: localhost\r\n"
    request = get(b"/api/users", forwarded + token + PLAIN)
    assert statuses(answers(site.address, request)) == [200]
    assert statuses(answers(site.address, request, source="127.0.0.2")) == [403]


@pytest.mark.parametrize("front", FRONTS)
def test_streams_pass_and_a_cut_frees_their_place(site: Site, front: str) -> None:
    """The first event arrives while the stream is open. A user has at most three streams, and clients that vanish lose their
    place.
    """
    for _ in range(3):
        with contextlib.ExitStack() as stack:
            for _ in range(STREAMS):
                line, received = open_stream(site, front)
                stack.enter_context(line)
                while b"event: " not in received:
                    received += (data := line.recv(65536))
                    assert data, received[-500:]
                vanish(line)


def open_stream(site: Site, front: str) -> tuple[ssl.SSLSocket, bytes]:
    """Return a stream and its first bytes, as soon as the server has removed the streams of clients that vanished."""
    key = f"Authorization: {site.server.headers['Authorization']}\r\n\r\n".encode()
    limit_s = time.monotonic() + 60
    while True:
        line = site.connect(front)
        line.sendall(get(b"/api/stream", HOST + key))
        head = line.recv(65536)
        if statuses(head) == [200]:
            return line, head
        line.close()
        assert time.monotonic() < limit_s, head
        time.sleep(0.2)


def vanish(line: ssl.SSLSocket) -> None:
    """Make the connection end with a reset instead of a farewell."""
    line.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))


def test_plain_http_is_redirected_and_gets_no_cookie(site: Site) -> None:
    """nginx answers plain HTTP with a redirect only. Over TLS both proxies send HSTS."""
    address = ("127.0.0.1", site.plain_port)
    received = answers(address, b"GET /api/session HTTP/1.1\r\nCookie: gss_session=stolen\r\n" + PLAIN)
    head = received.partition(b"\r\n\r\n")[0].lower()
    assert statuses(received) == [301]
    assert b"location: https://localhost/api/session" in head
    assert b"set-cookie" not in head
    for front in FRONTS:
        head = site.ask(front, get(b"/api/session")).partition(b"\r\n\r\n")[0].lower()
        assert b"strict-transport-security: max-age=31536000" in head


@pytest.mark.parametrize("front", FRONTS)
def test_abort_is_answered_while_clients_stall_and_vanish(site: Site, front: str) -> None:
    """Half handshakes, half heads, half bodies and resets through the proxy delay no ABORT of another client."""
    address = ("127.0.0.1", site.ports[front])
    body = b"POST /api/session HTTP/1.1\r\nX-GSS: 1\r\nContent-Length: 60000\r\n" + HOST + b"\r\n "
    url = f"https://localhost:{site.ports[front]}/api/commands/abort"
    with contextlib.ExitStack() as stack:
        for number in range(30):
            stack.enter_context(socket.create_connection(address, 30)).sendall(b"\x16\x03\x01\x02")
            for begun in (b"GET / HTTP/1.1\r\nX-Slow: ", body):
                line = stack.enter_context(site.connect(front))
                line.sendall(begun)
                if number % 3 == 0:
                    vanish(line)
                    line.close()
            if number % 10 == 9:
                reply = httpx2.post(url, headers=site.server.headers, verify=site.trust, timeout=30)
                assert (reply.status_code, reply.json()["message"]) == (409, "ABORT was not sent: the line is down.")


def test_the_server_still_works_afterwards(site: Site) -> None:
    """After all attacks the server answers an admin through both proxies, and its log has no traceback."""
    for port in site.ports.values():
        address = f"https://localhost:{port}/api"
        with httpx2.Client(base_url=address, headers=site.server.headers, timeout=30, verify=site.trust) as client:
            assert client.get("/link").status_code == 200
            assert client.get("/audit/verify").json()["problem"] == ""
    assert "Traceback" not in site.server.log(), site.server.log()[-3000:]
