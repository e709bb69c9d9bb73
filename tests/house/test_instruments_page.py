"""The examples of docs/instruments.md work as printed."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest

from gss.device.driver import Driver, UnitSetup, open_driver
from gss.device.session_events import Telemetry
from gss.instruments.package import Instrument, load_instrument
from gss.instruments.package_source import is_package_file
from gss.instruments.registry import shipped_registry

BLOCK = re.compile(r"```(?:yaml|python)\n# (?P<name>[a-z_.]+)\n(?P<text>.*?)```", re.DOTALL)


@pytest.fixture
def blocks(root: Path) -> dict[str, str]:
    """The example files of the page by name."""
    text = (root / "docs" / "instruments.md").read_text("utf-8")
    return {match["name"]: match["text"] for match in BLOCK.finditer(text)}


@pytest.fixture
def example(blocks: dict[str, str]) -> Instrument:
    """The package of the page, with the camera of a shipped package."""
    files = {name: text.encode() for name, text in blocks.items() if is_package_file(name)}
    files["camera.yaml"] = shipped_registry().get("nos3").files["camera.yaml"]
    files["instrument.yaml"] = (
        b'id: example\ntitle: "Example"\nversion: "1"\ndriver: link\nmounting: {camera: zenith}\n'
    )
    return load_instrument(files)


def temperatures(session: Driver, data: bytes) -> list[Any]:
    """Return the temperatures that the session decodes from these bytes."""
    return [e.values["temperature_c"] for e in session.feed(data, 0.1) if isinstance(e, Telemetry)]


def test_the_package_of_the_page_sends_and_reads_the_bytes_of_the_page(example: Instrument, root: Path) -> None:
    """Request and response have the printed bytes. A response without checksum is not decoded."""
    text = (root / "docs" / "instruments.md").read_text("utf-8")
    request, response = re.findall(r"`(A5 5A [0-9A-F ]+)`", text)
    session = open_driver(example)
    session.link_up(0.0)
    sent, _ = session.poll(0.0)
    assert sent == bytes.fromhex(request)
    damaged = bytearray(bytes.fromhex(response))
    damaged[4] ^= 1
    assert temperatures(session, bytes(damaged)) == []
    assert temperatures(session, bytes.fromhex(response)) == [pytest.approx(25.0)]


def test_the_driver_of_the_page_reads_lines(example: Instrument, blocks: dict[str, str]) -> None:
    """The driver repeats its request, reports decoded values and ignores other lines."""
    scope: dict[str, Any] = {}
    exec(blocks["driver.py"], scope)  # noqa: S102 - our own page
    session = scope["open_session"](UnitSetup(example.dictionary, example.link, example.name))
    session.link_up(0.0)
    assert session.poll(0.0)[0] == b"GET_STATE\n"
    assert temperatures(session, b"hello\nT=2") == []
    assert temperatures(session, b"5.0\n") == [25.0]
