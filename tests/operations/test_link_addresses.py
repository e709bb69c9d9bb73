"""Addresses that are valid for a link, and those that an operator may open."""

from __future__ import annotations

import pytest

from gss.device.line_address import EXPECTED, LineAddress, parse_line_address
from gss.domain.errors import BadInput
from gss.operations.line.addresses import is_allowed

LIST = "serial-server.lab, 10.0.5.0/24, fd00::/8"


@pytest.mark.parametrize(
    ("url", "allowed"),
    [
        ("/dev/ttyUSB0", True),
        ("socket://127.0.0.1:7000", True),
        ("socket://localhost:7000", True),
        ("rfc2217://[::1]:7000", True),
        ("socket://10.0.5.9:7000", True),
        ("rfc2217://Serial-Server.LAB:2217", True),
        ("socket://[fd00::7]:1", True),
        ("zmq://127.0.0.1:5555", True),
        ("can://socketcan/can0", True),
        ("can://slcan/dev/ttyACM0", True),
        ("can://udp_multicast/239.74.163.2:43113", False),
        ("zmq://10.0.6.1:5555", False),
        ("socket://10.0.6.1:7000", False),
        ("socket://192.168.1.1:22", False),
        ("socket://serial-server.lab.example:22", False),
        ("socket://127.1:22", False),
        ("socket://2130706433:22", False),
    ],
)
def test_an_operator_may_open_local_devices_and_listed_addresses(url: str, allowed: bool) -> None:
    """Devices, loopback addresses, and listed names and networks are allowed. Names are compared as text, and another
    spelling of an address is a name."""
    assert is_allowed(parse_line_address(url), LIST) is allowed
    assert is_allowed(parse_line_address("socket://10.0.5.9:7000"), "") is False


@pytest.mark.parametrize(
    "url",
    [
        "",
        "SOCKET://10.0.6.1:7000",
        "socket://",
        "socket://:7000",
        "socket://[::1:22",
        "socket://[localhost]:22",
        "socket://[::1%?logging=debug]:22",
        "socket://10.0.5.9@192.168.1.1:22",
        "socket://user:word@127.0.0.1:22",
        "socket://127.0.0.1",
        "socket://127.0.0.1:",
        "socket://127.0.0.1:0",
        "socket://127.0.0.1:65536",
        "socket://127.0.0.1:-1",
        "socket://127.0.0.1:+7",
        "socket://127.0.0.1:٧",
        "socket://127.0.0.1:7/",
        "socket://127.0.0.1:7?logging=debug",
        "rfc2217://127.0.0.1:7?timeout=100000",
        "rfc2217://127.0.0.1:7?ign_set_control",
        "rfc2217://127.0.0.1:7/x",
        "rfc2217://127.0.0.1:7#x",
        " socket://127.0.0.1:7",
        "socket://127.0.0.1:7\r\n",
        "/dev/tty\x00",
        "spy:///dev/null?file=/tmp/x",
        "hwgrep://.*",
        "loop://",
        "zmq://*:5555",
        "zmq://127.0.0.1:5555/topic",
        "can://",
        "can://can0",
        "can://virtual/0",
        "can://socketcan/can0?bitrate=1",
        "can://socketcan/a-name-of-16-chrs",
        "can://socketcan/../x",
        "can://slcan/etc/passwd",
        "can://slcan/dev/../etc/passwd",
        "can://slcan/dev/ttyACM0@1000000",
        "can://udp_multicast/239.74.163.2",
        "can://udp_multicast/239.74.163.2:0",
        "can://udp_multicast/239.74.163.256:43113",
        "can://udp_multicast/10.0.0.1:43113",
    ],
)
def test_only_host_and_port_or_a_path_form_an_address(url: str) -> None:
    """Addresses with a user name, path, query, fragment, another scheme or an invalid port are rejected."""
    with pytest.raises(BadInput) as error:
        parse_line_address(url)
    assert error.value.expected == EXPECTED


def test_an_address_has_scheme_host_and_port() -> None:
    """A parsed address has scheme, host, port and channel, and its unchanged text."""
    assert parse_line_address("/dev/ttyS0") == LineAddress("/dev/ttyS0")
    text = "rfc2217://[FE80::1%eth0]:65535"
    assert parse_line_address(text) == LineAddress(text, "rfc2217", "fe80::1%eth0", 65535)
    text = "can://udp_multicast/239.0.0.1:7"
    assert parse_line_address(text) == LineAddress(text, "can", "239.0.0.1", 7, "udp_multicast", "239.0.0.1")
    assert parse_line_address("can://slcan/dev/serial/by-id/usb-x").channel == "/dev/serial/by-id/usb-x"
