"""Where an operator may open a line."""

from __future__ import annotations

import pytest

from gss.operations.line.addresses import is_allowed

LIST = "serial-server.lab, 10.0.5.0/24, fd00::/8"


@pytest.mark.parametrize(
    ("url", "allowed"),
    [
        ("/dev/ttyUSB0", True),
        ("SOCKET://10.0.6.1:7000", False),
        ("socket://127.0.0.1:7000", True),
        ("socket://localhost:7000", True),
        ("rfc2217://[::1]:7000", True),
        ("socket://10.0.5.9:7000", True),
        ("rfc2217://Serial-Server.LAB:2217", True),
        ("socket://[fd00::7]:1", True),
        ("socket://10.0.6.1:7000", False),
        ("socket://192.168.1.1:22", False),
        ("socket://serial-server.lab.example:22", False),
        ("socket://127.1:22", False),
        ("socket://2130706433:22", False),
        ("socket://10.0.5.9@192.168.1.1:22", False),
        ("socket://[::1:22", False),
        ("socket://", False),
    ],
)
def test_an_operator_opens_this_machine_and_what_is_listed(url: str, allowed: bool) -> None:
    """Devices, loopback, listed names and networks; another writing of an address is a name, and names count as written."""
    assert is_allowed(url, LIST) is allowed
    assert is_allowed("socket://10.0.5.9:7000", "") is False
