"""Reader of orbit files: two-line elements, CCSDS OMM (JSON, KVN, XML) and CCSDS OEM (KVN). The format is detected from the
content."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Literal

from gss.domain.errors import BadInput
from gss.orbit.oem import check_steps, read_oem
from gss.orbit.omm import fields_of_json, fields_of_kvn, fields_of_xml, tle_of_omm
from gss.orbit.trajectory import TleTrajectory, Trajectory, covers

MAX_CHARACTERS = 900_000
MAX_NAME_LENGTH = 80
OrbitKind = Literal["tle", "oem"]


@dataclass(frozen=True)
class ReadOrbit:
    """Content of an orbit file. ``kind``: format of ``text``. An OMM is stored as a TLE with the same elements.
    ``source_format``: format of the file. ``name``: name of the object, "" if the file does not contain it."""

    kind: OrbitKind
    source_format: str
    name: str
    text: str
    orbit: Trajectory


def read_orbit(text: str) -> ReadOrbit:
    """Read an orbit file. Raises BadInput that names the invalid part."""
    if len(text) > MAX_CHARACTERS:
        raise BadInput(
            "the orbit file is too large",
            expected=f"at most {MAX_CHARACTERS} characters",
            got=str(len(text)),
            hint="Import fewer days or a larger step.",
        )
    content = text.lstrip("\ufeff").strip()
    if content.startswith("<"):
        return _omm("OMM XML", fields_of_xml(content))
    if content.startswith(("{", "[")):
        return _omm("OMM JSON", fields_of_json(_json(content)))
    if content.startswith("CCSDS_OMM_VERS"):
        return _omm("OMM KVN", fields_of_kvn(content))
    if content.startswith("CCSDS_OEM_VERS"):
        name, orbit = read_oem(content)
        check_steps(orbit)
        return ReadOrbit("oem", "OEM KVN", name[:MAX_NAME_LENGTH], content + "\n", orbit)
    return _tle("TLE", content)


def read_orbits(text: str) -> list[Trajectory]:
    """Read an orbit file, or a file with several two-line element sets. Raises BadInput."""
    lines = [line.rstrip() for line in text.lstrip("\ufeff").splitlines() if line.strip()]
    ends = [k for k, line in enumerate(lines) if line.startswith("2 ")]
    if len(ends) < 2 or not lines[ends[0] - 1].startswith("1 "):
        return [read_orbit(text).orbit]
    if len(text) > MAX_CHARACTERS:
        raise BadInput("the file of element sets is too long", expected=f"at most {MAX_CHARACTERS} characters")
    starts = [0, *(k + 1 for k in ends[:-1])]
    return [TleTrajectory.of("\n".join(lines[a : b + 1])) for a, b in zip(starts, ends, strict=True)]


def orbit_covering(orbits: Sequence[Trajectory], time: datetime) -> Trajectory | None:
    """Return the orbit that is valid at ``time`` and has the nearest epoch, None if there is none."""
    covering = [o for o in orbits if covers(o, time)]
    return min(covering, key=lambda o: abs(o.epoch - time), default=None)


def stored_orbit(kind: OrbitKind, text: str) -> Trajectory:
    """Parse the text of a stored orbit and return the trajectory."""
    return TleTrajectory.of(text) if kind == "tle" else read_oem(text)[1]


def _tle(source_format: str, text: str) -> ReadOrbit:
    orbit = TleTrajectory.of(text)
    lines = [line.rstrip() for line in text.splitlines() if line.strip()]
    name = lines[0].removeprefix("0 ").strip() if len(lines) == 3 else ""
    return ReadOrbit("tle", source_format, name[:MAX_NAME_LENGTH], "\n".join(lines[-2:]) + "\n", orbit)


def _omm(source_format: str, fields: dict[str, str]) -> ReadOrbit:
    tle = tle_of_omm(fields)
    return ReadOrbit("tle", source_format, fields.get("OBJECT_NAME", "")[:MAX_NAME_LENGTH], tle, TleTrajectory.of(tle))


def _json(text: str) -> object:
    try:
        return json.loads(text)
    except (ValueError, RecursionError) as error:
        raise BadInput("the OMM is not valid JSON", expected="an object of OMM fields", got=str(error)[:120]) from None
