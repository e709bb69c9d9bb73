"""Reader and writer of CCSDS Orbit Ephemeris Messages in KVN (CCSDS 502.0-B-3 §5)."""

from __future__ import annotations

import math
from collections.abc import Iterator
from datetime import UTC, datetime
from itertools import pairwise

import numpy as np

from gss.catalogue_tools.corrections.ephemeris import TT_MINUS_UTC_S, teme_from_icrs
from gss.catalogue_tools.envelope.orbits import jyear_of
from gss.domain.angles import Array
from gss.domain.errors import BadInput
from gss.orbit.omm import omm_epoch
from gss.orbit.trajectory import EphemerisSegment, EphemerisTrajectory, Trajectory, teme_from_fixed, unix_s

MAX_STATES = 50_000
MIN_STATES = 4
MAX_ERROR_KM = 1.0
"""Maximum error of an interpolated position: the error of a TLE at its epoch. Permits steps of 8 min in low orbits, and of
18 min with velocities."""
VELOCITY_SHARE = 0.2
"""Largest difference between stated velocities and the movement between states, as a share of this movement. Larger ones are in
other units or missing."""
EARLIEST_S, LATEST_S = -6e10, 2.5e11
"""Range of Unix seconds that a date can represent in every time scale."""
MARGIN_S = 1.0
"""Time between the limits of a time span and the first and last exported state, for the calculation of velocities."""
MATRIX_EVERY_S = 3600.0
"""Time for which one rotation matrix is used. The axes of date rotate by 0.006″ in this time."""
INERTIAL = ("ICRF", "GCRF", "EME2000")
FIXED = "ITRF"
BEHIND_UTC_S = {"UTC": 0.0, "GPS": 18.0, "TAI": 37.0, "TT": TT_MINUS_UTC_S}
"""Seconds by which each time scale is ahead of UTC since 2017."""


def read_oem(text: str) -> tuple[str, EphemerisTrajectory]:
    """Return the name and the orbit of an OEM with one object. Raises BadInput that names the invalid line."""
    name, blocks, meta, in_meta = "", [], dict[str, str](), False
    for line, statement in _lines(text):
        if statement == "META_START":
            meta, in_meta = {}, True
        elif statement == "META_STOP":
            _check_meta(meta, name)
            name = meta["OBJECT_NAME"]
            blocks.append((meta, list[tuple[float, ...]]()))
            meta, in_meta = {}, False
        elif "=" in statement:
            key, _, value = statement.partition("=")
            meta[key.strip()] = value.strip()
        elif blocks and not in_meta:
            blocks[-1][1].append(_state(line, statement, blocks[-1][0]["TIME_SYSTEM"]))
        else:
            raise BadInput(f"line {line} of the OEM is not valid", expected="a META block", got=statement[:60])
    if not blocks:
        raise BadInput("the OEM has no ephemeris", expected="META_START, META_STOP and states", got="no META block")
    count = sum(len(states) for _, states in blocks)
    if not MIN_STATES <= count <= MAX_STATES:
        raise BadInput(
            "the OEM has an unusable number of states", expected=f"{MIN_STATES} to {MAX_STATES}", got=str(count)
        )
    segments = tuple(_segment(np.array(states), m) for m, states in blocks if states)
    in_segments = all((np.diff(segment.times_s) > 0).all() for segment in segments)
    # Consecutive segments can contain the same time at their boundary.
    if not in_segments or any(b.times_s[0] < a.times_s[-1] for a, b in pairwise(segments)):
        raise BadInput(
            "the states of the OEM are not in order of time", expected="times that increase from line to line"
        )
    return name, EphemerisTrajectory(segments)


def check_steps(orbit: EphemerisTrajectory) -> None:
    """Raise BadInput if the states of a segment are too far apart, or too few, for interpolation."""
    error_km, worst = max(((s.error_km, s) for s in orbit.segments), key=lambda pair: pair[0])
    if error_km > MAX_ERROR_KM:
        raise BadInput(
            "the states of the OEM are too far apart for interpolation",
            expected=f"an error of at most {MAX_ERROR_KM:g} km between two states",
            got=f"about {error_km:.3g} km with {len(worst.times_s)} states and steps of up to {np.diff(worst.times_s).max():g} s",
            hint="Export the ephemeris with smaller steps, or in ICRF with velocities and INTERPOLATION = HERMITE.",
        )


def oem_of(
    name: str, orbit: Trajectory, start: datetime, end: datetime, step_s: float, created: datetime
) -> Iterator[str]:
    """Yield the lines of an OEM in ICRF and UTC with one segment per time span of the orbit. The times are whole milliseconds.
    Raises BadInput if the orbit is not valid between ``start`` and ``end``."""
    spans = [(max(a + MARGIN_S, unix_s(start)), min(b - MARGIN_S, unix_s(end))) for a, b in orbit.spans]
    spans = [(first_s, last_s) for first_s, last_s in spans if first_s <= last_s]
    if not spans:
        orbit.teme_km(np.array([unix_s(start)]))  # raises the error that names the valid span
    yield f"CCSDS_OEM_VERS = 2.0\nCREATION_DATE = {created:%Y-%m-%dT%H:%M:%S}\nORIGINATOR = GSS\n"
    for first_s, last_s in spans:
        yield from _segment_lines(name, orbit, np.arange(round(first_s, 3), last_s + 1e-3, step_s), step_s)


def _segment_lines(name: str, orbit: Trajectory, times_s: Array, step_s: float) -> Iterator[str]:
    """Yield the lines of a segment with states at (n,) Unix seconds."""
    knots_s = np.concatenate([times_s - 0.5, times_s, times_s + 0.5])
    teme = orbit.teme_km(knots_s).reshape(3, -1, 3)
    first, last = (f"{datetime.fromtimestamp(t, UTC):%Y-%m-%dT%H:%M:%S.%f}"[:-3] for t in (times_s[0], times_s[-1]))
    yield "\nMETA_START\n"
    yield f"OBJECT_NAME = {name}\nOBJECT_ID = {name}\nCENTER_NAME = EARTH\nREF_FRAME = ICRF\nTIME_SYSTEM = UTC\n"
    yield f"START_TIME = {first}\nSTOP_TIME = {last}\nMETA_STOP\n\n"
    for k, at_s in enumerate(times_s):
        if k % max(1, int(MATRIX_EVERY_S / step_s)) == 0:
            icrs_from_teme = teme_from_icrs(jyear_of(datetime.fromtimestamp(at_s, UTC))).T
        position, velocity = icrs_from_teme @ teme[1, k], icrs_from_teme @ (teme[2, k] - teme[0, k])
        numbers = " ".join([*(f"{v:.6f}" for v in position), *(f"{v:.9f}" for v in velocity)])
        yield f"{datetime.fromtimestamp(at_s, UTC):%Y-%m-%dT%H:%M:%S.%f}"[:-3] + f" {numbers}\n"


def _lines(text: str) -> Iterator[tuple[int, str]]:
    """Yield line number and text of each statement. Comments and covariance blocks are omitted."""
    covariance = False
    for number, line in enumerate(text.splitlines(), 1):
        statement = line.strip()
        covariance = (covariance or statement == "COVARIANCE_START") and statement != "COVARIANCE_STOP"
        if statement and not covariance and not statement.startswith(("COMMENT", "COVARIANCE_STOP")):
            yield number, statement


def _check_meta(meta: dict[str, str], name: str) -> None:
    for key in ("OBJECT_NAME", "CENTER_NAME", "REF_FRAME", "TIME_SYSTEM"):
        if not meta.get(key):
            raise BadInput(f"the OEM states no {key}", expected=f"{key} in each META block")
    if meta["CENTER_NAME"].upper() != "EARTH":
        raise BadInput("CENTER_NAME of the OEM is not supported", expected="EARTH", got=meta["CENTER_NAME"][:40])
    frame, system = meta["REF_FRAME"].upper(), meta["TIME_SYSTEM"].upper()
    if frame not in (*INERTIAL, "TEME") and not frame.startswith(FIXED):
        expected = ", ".join((*INERTIAL, "TEME", FIXED))
        raise BadInput("REF_FRAME of the OEM is not supported", expected=expected, got=meta["REF_FRAME"][:40])
    if system not in BEHIND_UTC_S:
        raise BadInput("TIME_SYSTEM of the OEM is not supported", expected=", ".join(BEHIND_UTC_S), got=system[:40])
    if name and meta["OBJECT_NAME"] != name:
        raise BadInput("the OEM has several objects", expected=name, got=meta["OBJECT_NAME"][:40])


def _state(line: int, statement: str, system: str) -> tuple[float, ...]:
    """Return the Unix seconds, the position in km and the velocity in km/s of a state; NaN without a velocity."""
    parts = statement.split()
    try:
        numbers = tuple(float(part) for part in parts[1:])
    except ValueError:
        numbers = ()
    if len(numbers) not in (3, 6, 9) or not np.isfinite(numbers).all() or max(map(abs, numbers[:3])) > 1e7:
        raise BadInput(
            f"line {line} of the OEM is not a state", expected="time x y z vx vy vz, in km", got=statement[:80]
        )
    at_s = unix_s(omm_epoch(parts[0])) - BEHIND_UTC_S[system.upper()]
    if not EARLIEST_S < at_s < LATEST_S:
        raise BadInput(f"the time in line {line} of the OEM is out of range", got=parts[0][:40])
    return at_s, *(numbers + (math.nan,) * 3)[:6]


def _segment(states: Array, meta: dict[str, str]) -> EphemerisSegment:
    """Return a segment of (n, 7) states (time, position, velocity). Velocities are used if the OEM states Hermite interpolation.
    They are ignored in rotating axes, in which programs state different velocities."""
    times_s, frame = states[:, 0], meta["REF_FRAME"]
    places_km = _teme(times_s, states[:, 1:4], frame)
    if meta.get("INTERPOLATION", "").upper() != "HERMITE" or frame.upper().startswith(FIXED):
        return EphemerisSegment(times_s, places_km)
    velocities_km_s = _teme(times_s, states[:, 4:], frame)
    moved_km = np.diff(places_km, axis=0)
    by_velocity_km = np.diff(times_s)[:, None] * (velocities_km_s[1:] + velocities_km_s[:-1]) / 2
    difference_km = np.linalg.norm(by_velocity_km - moved_km, axis=1)
    agree = (difference_km <= VELOCITY_SHARE * np.linalg.norm(moved_km, axis=1)).all()
    return EphemerisSegment(times_s, places_km, velocities_km_s if agree else None)


def _teme(times_s: Array, positions: Array, frame: str) -> Array:
    """Return (n, 3) vectors in TEME from a frame at (n,) Unix seconds."""
    name = frame.upper()
    if name == "TEME":
        return positions
    if name.startswith(FIXED):
        return teme_from_fixed(positions, times_s)
    block = np.floor((times_s - times_s[0]) / MATRIX_EVERY_S)
    rotated = np.empty_like(positions)
    for number in np.unique(block):
        chosen = block == number
        matrix = teme_from_icrs(jyear_of(datetime.fromtimestamp(float(times_s[chosen].mean()), UTC)))
        rotated[chosen] = positions[chosen] @ matrix.T
    return rotated
