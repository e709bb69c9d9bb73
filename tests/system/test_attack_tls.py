"""The server's own TLS under attack: ambiguous requests, damaged or slow handshakes, renegotiation, cut connections."""

from __future__ import annotations

import contextlib
import socket
import ssl
import struct
import subprocess
from collections.abc import Iterator
from typing import Any

import httpx2
import pytest

from tools.hostile_requests import FRAMING, UNANSWERED, answers, check_harmless, get, statuses
from tools.served import Served, served

pytestmark = pytest.mark.timeout(400)
SLOW_CLIENTS = 20
"""Clients of each kind that begin a handshake or a request and do not complete it."""
CLIENT_HELLO = bytes.fromhex("1603010200010001fc0303")


@pytest.fixture(scope="module")
def server(certificate: Any, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    """Server with TLS that receives all requests of this file."""
    files = {"GSS_TLS_CERTIFICATE": str(certificate.chain), "GSS_TLS_KEY": str(certificate.key)}
    with served(tmp_path_factory.mktemp("attacked") / "data", **files) as server:
        yield server


@pytest.mark.parametrize("name", FRAMING)
def test_a_hostile_request_inside_tls_is_rejected_or_harmless(server: Served, certificate: Any, name: str) -> None:
    """TLS changes no answer: no second request, no other protocol, no injected header."""
    received = answers(server.host_and_port, FRAMING[name], certificate.trust)
    check_harmless(name, received)
    assert statuses(received) or name in UNANSWERED


def test_the_tls_port_answers_only_tls(server: Served) -> None:
    """Plain requests and damaged handshakes get no HTTP response. A client that offers only TLS 1.1 is refused."""
    for request in (
        get(b"/api/session"),
        CLIENT_HELLO + bytes(600),
        bytes(10_000),
        b"\x16\x03\x01\xff\xff" + bytes(70_000),
    ):
        received = answers(server.host_and_port, request)
        assert not statuses(received), received[:200]
        assert b"PRIVATE KEY" not in received
    old = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    old.check_hostname, old.verify_mode = False, ssl.CERT_NONE
    old.set_ciphers("ALL:@SECLEVEL=0")
    with pytest.warns(DeprecationWarning, match="TLSv1"):
        old.minimum_version, old.maximum_version = ssl.TLSVersion.TLSv1, ssl.TLSVersion.TLSv1_1
    with socket.create_connection(server.host_and_port, 20) as line, pytest.raises(OSError):
        old.wrap_socket(line)


def test_a_client_cannot_renegotiate(server: Served, certificate: Any) -> None:
    """A renegotiation makes the server compute a key again and again on one connection. The server refuses it."""
    host, port = server.host_and_port
    command = ["openssl", "s_client", "-connect", f"{host}:{port}", "-tls1_2", "-CAfile", str(certificate.chain)]
    report = subprocess.run(command, input=b"R\n", capture_output=True, timeout=60)
    assert b"RENEGOTIATING" in report.stdout + report.stderr
    assert b"no renegotiation" in report.stderr, report.stderr[-500:]


def test_unfinished_handshakes_and_requests_leave_abort_and_streams_working(server: Served, certificate: Any) -> None:
    """While clients hold half a handshake or half a request, and others cut streams in the middle of a TLS record, ABORT on a
    new connection is answered and an open event stream continues.
    """
    key = f"Authorization: {server.headers['Authorization']}\r\n\r\n".encode()
    follow = get(b"/api/stream", b"Host: localhost\r\n" + key)

    def tls_line() -> ssl.SSLSocket:
        return certificate.trust.wrap_socket(
            socket.create_connection(server.host_and_port, 30), server_hostname="localhost"
        )

    with contextlib.ExitStack() as stack, httpx2.Client(verify=certificate.trust, timeout=30) as client:
        stream = stack.enter_context(tls_line())
        stream.sendall(follow)
        assert stream.recv(4096).startswith(b"HTTP/1.1 200")
        for number in range(SLOW_CLIENTS):
            begun = stack.enter_context(socket.create_connection(server.host_and_port, 30))
            begun.sendall(CLIENT_HELLO[: 1 + number % len(CLIENT_HELLO)])
            stack.enter_context(tls_line()).sendall(b"GET /api/session HTTP/1.1\r\nX-Slow: ")
            cut = tls_line()
            cut.sendall(follow[: None if number % 2 else 40])
            cut.setsockopt(
                socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0)
            )  # a reset instead of a farewell
            cut.close()
            if number % 5 == 0:
                address = server.address.replace("127.0.0.1", "localhost")
                reply = client.post(f"{address}/api/commands/abort", headers={**server.headers, "Connection": "close"})
                assert (reply.status_code, reply.json()["message"]) == (409, "ABORT was not sent: the line is down.")
        received = stream.recv(65536)
        assert received, "the event stream was dropped"


def test_the_server_still_works_afterwards(server: Served, certificate: Any) -> None:
    """After all attacks the server answers an admin, and its log has no traceback."""
    address = server.address.replace("127.0.0.1", "localhost")
    with httpx2.Client(
        base_url=f"{address}/api", headers=server.headers, timeout=30, verify=certificate.trust
    ) as client:
        assert client.get("/link").status_code == 200
        assert client.get("/audit/verify").json()["problem"] == ""
    assert "Traceback" not in server.log(), server.log()[-3000:]
