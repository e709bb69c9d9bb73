"""Reader of CCSDS attitude messages in KVN: AEM of versions 1 and 2, ACM of version 2 (CCSDS 504.0-B).

Quaternions between an inertial frame (ICRF, GCRF or EME2000) and one frame of the spacecraft are supported.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from gss.domain.angles import Array
from gss.domain.errors import BadInput
from gss.domain.rotation import quaternion_inverse
from gss.orbit.attitude import AttitudeHistory
from gss.orbit.oem import BEHIND_UTC_S, EARLIEST_S, INERTIAL, LATEST_S
from gss.orbit.omm import omm_epoch
from gss.orbit.trajectory import unix_s

MAX_ATTITUDES = 200_000
MAX_NAME_LENGTH = 80
UNIT_LENGTH = 1e-3
BLOCKS = ("META", "DATA", "ATT", "COV", "PHYS", "MAN", "AD", "USER")
STATED_TYPE = ("ATTITUDE_TYPE", "ATT_TYPE")


@dataclass
class _Block:
    """Keywords of a block, and its lines of numbers with their line numbers."""

    name: str
    keys: dict[str, str] = field(default_factory=dict)
    rows: list[tuple[int, list[str]]] = field(default_factory=list)


def read_attitude_file(data: bytes) -> AttitudeHistory:
    """Return the attitudes of a file; see :func:`read_attitude`."""
    return read_attitude(data.decode("utf-8", "replace"))


def read_attitude(text: str) -> AttitudeHistory:
    """Return the attitudes of an AEM or ACM. Raises BadInput that names the invalid line or keyword."""
    head = text.lstrip("\ufeff \r\n")
    if head.startswith("CCSDS_AEM_VERS"):
        return _history(_aem_segments(_blocks(head)))
    if head.startswith("CCSDS_ACM_VERS"):
        return _history(_acm_segments(_blocks(head)))
    raise BadInput(
        "The file is not an attitude message", expected="a CCSDS AEM or ACM in KVN", got=head[:40] or "an empty file"
    )


def _blocks(text: str) -> list[_Block]:
    """Split a message at X_START and X_STOP. Keywords and data lines outside such blocks are returned in blocks without a name."""
    blocks = [_Block("")]
    for number, line in enumerate(text.splitlines(), 1):
        statement = line.strip()
        if not statement or statement.startswith("COMMENT"):
            continue
        name, _, edge = statement.rpartition("_")
        if edge == "START" and name in BLOCKS:
            blocks.append(_Block(name))
        elif edge == "STOP" and name in BLOCKS:
            if blocks[-1].name != name:
                raise BadInput(
                    f"Line {number} of the message is not valid",
                    expected="the STOP line of the open block",
                    got=statement,
                )
            blocks.append(_Block(""))
        elif "=" in statement:
            key, _, value = statement.partition("=")
            blocks[-1].keys[key.strip()] = value.partition("[")[0].strip()
        else:
            blocks[-1].rows.append((number, statement.split()))
    return blocks


Segment = tuple[dict[str, str], list[tuple[int, list[str]]]]
"""Keywords of a segment, and its data lines with their line numbers."""


def _aem_segments(blocks: list[_Block]) -> Iterator[Segment]:
    keys: dict[str, str] = {}
    for block in blocks:
        if block.name == "META":
            keys = block.keys
        elif block.name in ("", "DATA") and block.rows:
            if not keys:
                raise BadInput(
                    f"Line {block.rows[0][0]} of the message is not valid", expected="a META block before it"
                )
            yield keys, block.rows


def _acm_segments(blocks: list[_Block]) -> Iterator[Segment]:
    meta: dict[str, str] = {}
    for block in blocks:
        if block.name == "META":
            meta = block.keys
        elif block.name == "ATT":
            yield meta | block.keys, block.rows


def _history(segments: Iterator[Segment]) -> AttitudeHistory:
    times: list[float] = []
    quaternions: list[Array] = []
    named: tuple[str, str] | None = None
    for keys, rows in segments:
        frame, from_spacecraft = _frame(keys)
        name = keys.get("OBJECT_NAME", "")
        for shown in (name, frame):
            if len(shown) > MAX_NAME_LENGTH or not shown.isprintable():
                expected = f"at most {MAX_NAME_LENGTH} printable characters"
                raise BadInput("A name in the message cannot be shown", expected=expected, got=repr(shown[:40]))
        if named is not None and named != (name, frame):
            raise BadInput("The message has several objects or frames", expected=" ".join(named), got=f"{name} {frame}")
        named = (name, frame)
        if len(times) + len(rows) > MAX_ATTITUDES:
            raise BadInput("The message has too many attitudes", expected=f"at most {MAX_ATTITUDES}")
        for line, parts in rows:
            t, quaternion = _row(line, parts, keys)
            if times and t == times[-1]:  # consecutive segments can contain the same attitude at their boundary
                continue
            times.append(t)
            quaternions.append(quaternion if from_spacecraft else quaternion_inverse(quaternion))
    if named is None or not times:
        raise BadInput("The message has no attitudes", expected="lines of a time and a quaternion")
    unknown = np.full((len(times), 3), np.nan)
    return AttitudeHistory(*named, np.array(times), np.array(quaternions), unknown)


def _frame(keys: dict[str, str]) -> tuple[str, bool]:
    """Return the frame of the spacecraft, and True if the quaternions rotate from it to the inertial frame. Raises BadInput."""
    stated = next((keys[name] for name in STATED_TYPE if name in keys), "")
    if stated.upper() != "QUATERNION":
        raise BadInput("The type of the attitudes is not supported", expected="QUATERNION", got=stated[:40] or "none")
    if keys.get("TIME_SYSTEM", "").upper() not in BEHIND_UTC_S:
        expected = ", ".join(BEHIND_UTC_S)
        raise BadInput("TIME_SYSTEM is not supported", expected=expected, got=keys.get("TIME_SYSTEM", "none")[:40])
    a, b = keys.get("REF_FRAME_A", ""), keys.get("REF_FRAME_B", "")
    if (a.upper() in INERTIAL) == (b.upper() in INERTIAL):
        expected = f"{' or '.join(INERTIAL)}, and a frame of the spacecraft"
        raise BadInput("The frames are not supported", expected=expected, got=f"{a[:40]} and {b[:40]}")
    from_inertial = a.upper() in INERTIAL
    backwards = keys.get("ATTITUDE_DIR", "A2B").upper() == "B2A"
    return (b if from_inertial else a), from_inertial == backwards


def _row(line: int, parts: list[str], keys: dict[str, str]) -> tuple[float, Array]:
    """Return the Unix seconds and the scalar-last quaternion of a data line. Raises BadInput."""
    try:
        numbers = np.array([float(part) for part in parts[1:]])
        zero = keys.get("EPOCH_TZERO")
        t = unix_s(omm_epoch(parts[0])) if zero is None else unix_s(omm_epoch(zero)) + float(parts[0])
    except (ValueError, OverflowError):
        numbers, t = np.empty(0), np.nan
    length = float(np.linalg.norm(numbers)) if len(numbers) == 4 else np.nan
    if not (EARLIEST_S < t < LATEST_S and abs(length - 1) < UNIT_LENGTH):
        raise BadInput(
            f"Line {line} of the message is not an attitude",
            expected="a time and a quaternion of length 1",
            got=" ".join(parts)[:80],
        )
    if keys.get("QUATERNION_TYPE", "LAST").upper() == "FIRST":
        numbers = np.roll(numbers, -1)
    return t - BEHIND_UTC_S[keys["TIME_SYSTEM"].upper()], numbers / length
