"""Definitions for OpenC3 COSMOS. ``tools/check_cosmos.py`` compares them with COSMOS itself."""

from __future__ import annotations

import re

import pytest

from gss.device.cosmos import HEADER_ITEMS, cosmos_files
from gss.device.protocol.codec import fixed_bytes
from gss.device.protocol.packet import CRC_BYTES, PRIMARY, SECONDARY
from gss.domain.errors import BadInput
from gss.instruments.registry import shipped_registry

CUBESTAR = shipped_registry().get("cubestar")
FILES = cosmos_files(CUBESTAR, "unit1")


def block(file: str, head: str) -> list[str]:
    """Return the lines of one packet."""
    blocks = FILES[file].split("\n\n")
    return next(b for b in blocks if b.startswith(f"{head} ")).splitlines()


def test_the_headers_have_the_size_of_the_protocol() -> None:
    assert sum(bits for _, bits in HEADER_ITEMS) == 8 * (PRIMARY.size + SECONDARY.size)


@pytest.mark.parametrize("command", CUBESTAR.dictionary.commands, ids=lambda c: c.name)
def test_a_command_has_all_its_bits_and_its_code(command) -> None:
    """The sizes of the parameters add up to the packet, and the ID parameters select only this command."""
    lines = block("cmd.txt", f"COMMAND UNIT1 {command.name}")
    bits = [int(m[1]) for line in lines if (m := re.match(r"\s+APPEND_(?:ID_)?PARAMETER \S+ (\d+) ", line))]
    assert sum(bits) == 8 * (PRIMARY.size + SECONDARY.size + fixed_bytes(command.arguments) + CRC_BYTES)
    assert f"  APPEND_ID_PARAMETER CODE 8 UINT MIN MAX {command.code}" in lines
    assert sum("REQUIRED" in line for line in lines) == sum(a.default is None for a in command.arguments)


def test_limits_have_four_bounds_within_each_other() -> None:
    """COSMOS requires four bounds; an absent level has a bound that no value exceeds."""
    rows = re.findall(r"^    LIMITS (\S+) \d+ ENABLED (.+)$", FILES["tlm.txt"], re.MULTILINE)
    assert len(rows) >= 10
    for name, text in rows:
        red_low, yellow_low, yellow_high, red_high = map(float, text.split())
        assert red_low <= yellow_low < yellow_high <= red_high, name


def test_a_completed_report_precedes_the_general_report() -> None:
    """COSMOS selects the first packet whose ID items agree."""
    names = re.findall(r"^TELEMETRY UNIT1 (\S+)", FILES["tlm.txt"], re.MULTILINE)
    assert names.index("REPORT") > max(k for k, name in enumerate(names) if name.startswith("REPORT_"))
    assert len(names) == len(set(names))


def test_texts_cannot_end_their_quotes() -> None:
    """Every line has an even number of double quotes."""
    assert all(line.count('"') % 2 == 0 for text in FILES.values() for line in text.splitlines())


def test_other_drivers_and_bad_names_are_rejected() -> None:
    with pytest.raises(BadInput, match="driver defines the header"):
        cosmos_files(shipped_registry().get("nos3"))
    with pytest.raises(BadInput, match="invalid name of a target"):
        cosmos_files(CUBESTAR, "unit 1")
