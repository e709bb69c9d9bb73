"""Units from ``gss serve --unit NAME=INSTRUMENT@ADDRESS``, and the settings of their processes."""

from __future__ import annotations

import os
import re
import shlex
from dataclasses import dataclass

from gss.device.line_address import parse_line_address
from gss.domain.errors import BadInput
from gss.instruments.registry import Registry
from gss.settings import Settings

SIMULATOR = "simulator"
"""Address of a unit whose process starts a simulated sensor."""
NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]{0,23}")
EXPECTED = "NAME=INSTRUMENT@ADDRESS, for example FM1=cubestar@/dev/ttyUSB0"
MAX_UNITS = 32


@dataclass(frozen=True)
class UnitSpec:
    """One physical sensor. ``name``: name in page addresses and of the data folder; ``address``: address of the line,
    or ``simulator``."""

    name: str
    instrument: str
    address: str

    @property
    def simulated(self) -> bool:
        """True if the unit's process starts a simulated sensor."""
        return self.address == SIMULATOR


def parse_units(text: str, instruments: Registry) -> tuple[UnitSpec, ...]:
    """Return the units of a comma-separated list; () for "". Raises BadInput for an invalid format, name or address, or
    for a duplicate name or address; NotFound if an instrument is not installed."""
    units = tuple(_unit(part.strip(), instruments) for part in text.split(",") if part.strip())
    if len(units) > MAX_UNITS:
        raise BadInput("too many units for one server", expected=f"at most {MAX_UNITS}", got=str(len(units)))
    _check_unique(
        "two units have the same name", [u.name.lower() for u in units], "names that differ in more than case"
    )
    _check_unique(
        "two units have the same address",
        [_line_of(u.address) for u in units if not u.simulated],
        "one unit per address",
    )
    return units


def _unit(text: str, instruments: Registry) -> UnitSpec:
    name, equals, address_text = text.partition("=")
    instrument, at, address = address_text.partition("@")
    if not (equals and at and instrument and address):
        raise BadInput("a unit needs a name, an instrument and an address", expected=EXPECTED, got=text[:80])
    if not NAME.fullmatch(name):
        raise BadInput(
            "invalid unit name", expected="1 – 24 letters, digits, - and _, first a letter or digit", got=name[:80]
        )
    if address != SIMULATOR:
        parse_line_address(address)
    if instrument not in instruments.names():  # the process of the unit reports an invalid package
        instruments.get(instrument)
    return UnitSpec(name, instrument, address)


def _line_of(address: str) -> str:
    """Return the address, or the path of the port to which it is a link (/dev/serial/by-id/…)."""
    return os.path.realpath(address) if address.startswith("/") else address


def _check_unique(message: str, values: list[str], expected: str) -> None:
    duplicates = sorted({value for value in values if values.count(value) > 1})
    if duplicates:
        raise BadInput(message, expected=expected, got=", ".join(duplicates))


def check_combination(settings: Settings) -> None:
    """Check that no setting for a single unit is combined with units. Raises BadInput otherwise."""
    single = {"device": settings.device, "simulator": settings.simulator, "workers": settings.workers}
    conflicting = ", ".join(f"--{name}" for name, value in single.items() if value)
    if conflicting:
        raise BadInput("this option cannot be used with --unit", got=conflicting, hint=f"give each line as {EXPECTED}")


def unit_settings(settings: Settings, unit: UnitSpec, number: int) -> Settings:
    """Return the settings of a unit's process. Its data are below the server's data folder; accounts and instrument
    packages are those of the server. ``number``: index in the list, which gives simulated units different seeds."""
    folder, blobs = settings.data / "units" / unit.name, settings.blobs
    return settings.model_copy(
        update={
            "units": "",
            "data": folder,
            "database": "",
            "blobs": f"{blobs.rstrip('/')}/units/{unit.name}" if blobs else "",
            "backups": str(settings.backups_folder / "units" / unit.name) if settings.backups else "",
            "audit_anchor": f"{settings.audit_anchor}.{unit.name}" if settings.audit_anchor else "",
            "accounts": settings.accounts or settings.database_url,
            "packages": str(settings.instruments_folder),
            "instrument": unit.instrument,
            "device": "" if unit.simulated else unit.address,
            "simulator": unit.instrument if unit.simulated else "",
            "simulator_seed": settings.simulator_seed + number,
            "simulator_options": _simulator_options(settings.simulator_options, unit.name),
        }
    )


def _simulator_options(options: str, name: str) -> str:
    """Return the simulator's options for one unit. On a body with several heads, the unit is the head with its name."""
    words = shlex.split(options)
    on_a_body = any(word == "--body" or word.startswith("--body=") for word in words)
    return f"{options} --head {name}" if on_a_body else options
