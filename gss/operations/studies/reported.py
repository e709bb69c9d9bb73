"""Attitudes, star lists and temperatures that a sensor reported, from stored telemetry."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from datetime import datetime, timedelta
from typing import Any

import numpy as np

from gss.domain.angles import ARCSEC_RAD, Array
from gss.domain.camera_profile import CameraProfile
from gss.domain.errors import BadInput
from gss.instruments.telemetry_roles import AttitudeRole, ItemList, StarEntry, Status
from gss.operations.frames.measured_list_files import StarLists
from gss.pipeline.analysis.series import AttitudeSeries
from gss.store import telemetry
from gss.store.engine import Database

MAX_ATTITUDES = 500_000
NEAR_S = 600.0
"""Maximum distance in seconds between a frame and the nearest packet for the interpolation of temperature."""
MAX_LISTS = 20_000
SOLVED = "solved"


def attitudes_of(
    database: Database, role: AttitudeRole, contact_id: int, start: datetime, end: datetime
) -> AttitudeSeries:
    """Return the attitudes of a contact in order of device time, one per frame. Without a device time, the times are those of
    reception. Raises BadInput if there are none or too many."""
    names = tuple(dict.fromkeys(role.fields().values()))
    attitudes: dict[float, Mapping[str, Any]] = {}
    for row in telemetry.rows(database, role.packet, names, start, end, contact_id=contact_id) if names else ():
        values: Mapping[str, Any] = role.read({n: v for n, v in zip(names, row.values, strict=True) if v is not None})
        if not role.frame_time_s or "frame_time_s" in values:
            time_s = row.device_time_s or row.received.timestamp()
            attitudes[float(values.get("frame_time_s", time_s))] = values
        if len(attitudes) > MAX_ATTITUDES:
            raise BadInput("too many attitudes", expected=f"up to {MAX_ATTITUDES}", hint="select a shorter contact")
    if not attitudes:
        raise BadInput(
            "this contact has no attitudes", expected="attitude packets", hint="start the cycle, or request attitudes"
        )
    times = sorted(attitudes)
    rows = [attitudes[t] for t in times]
    n = len(rows)
    quaternion, covariance = np.full((n, 4), np.nan), np.full((n, 3, 3), np.nan)
    for k, values in enumerate(rows):
        q = np.array([_number(values.get(f"quaternion_{axis}")) for axis in "xyzw"])
        if str(values.get("outcome", SOLVED)) == SOLVED and abs(np.linalg.norm(q) - 1) < 1e-3:
            quaternion[k] = q / np.linalg.norm(q)
        cross, roll = (_number(values.get(f"sigma_{axis}_arcsec")) * ARCSEC_RAD for axis in ("cross", "roll"))
        covariance[k] = np.diag([cross**2, cross**2, roll**2]) if cross > 0 else np.nan
    counts = np.array([[int(values.get(name) or 0) for name in ("centroids", "matched")] for values in rows], np.intp)
    return AttitudeSeries(np.array(times), quaternion, covariance, counts[:, 0], counts[:, 1], np.full(n, np.nan))


def star_lists_of(
    database: Database, role: ItemList, profile: CameraProfile, contact_id: int, start: datetime, end: datetime
) -> StarLists | None:
    """Return the measured stars that the sensor reported during a contact, one list per packet in order of reception.
    None if it reported none. Raises BadInput if there are too many."""
    if role.entry is None:
        return None
    first, stars = [0], list[tuple[float, float, float]]()
    for row in telemetry.rows(database, role.packet, (role.items,), start, end, contact_id=contact_id):
        stars += _stars(row.values[0] or [], role.entry, profile)
        first.append(len(stars))
        if len(first) > MAX_LISTS:
            raise BadInput("too many star lists", expected=f"up to {MAX_LISTS}", hint="select a shorter contact")
    if not stars:
        return None
    columns, rows, flux = np.array(stars).T
    return StarLists(columns, rows, flux, np.array(first, np.int64))


def _stars(
    items: list[Mapping[str, Any]], entry: StarEntry, profile: CameraProfile
) -> Iterator[tuple[float, float, float]]:
    """Yield column, row and relative flux of the entries whose position is a number."""
    camera, scale = profile.camera, (1.0, 1.0)
    centre = (0.0, 0.0)
    if entry.unit == "mm":
        scale = (profile.pitch_col_mm, profile.pitch_row_mm)
        centre = ((camera.columns - 1) / 2, (camera.rows - 1) / 2)
    for item in items:
        column, row = (
            _number(item[name]) / size + offset
            for name, size, offset in zip((entry.column, entry.row), scale, centre, strict=True)
        )
        flux = _number(item[entry.flux]) if entry.flux else 1.0
        if entry.magnitude:
            flux = 10 ** (-0.4 * _number(item[entry.magnitude]))
        if math.isfinite(column + row + flux):
            yield column, row, flux


def temperatures(database: Database, status: Status, start: datetime, end: datetime) -> tuple[Array, Array] | None:
    """Return Unix seconds and °C of the unit's temperatures during a time span and shortly before and after it; None if
    the unit does not report its temperature."""
    if not (status.packet and status.sensor_temperature):
        return None
    margin = timedelta(seconds=NEAR_S)
    rows = telemetry.rows(database, status.packet, (status.sensor_temperature,), start - margin, end + margin)
    by_time = {r.received.timestamp(): float(r.values[0]) for r in rows if r.values[0] is not None}
    return np.array(sorted(by_time)), np.array([by_time[t] for t in sorted(by_time)])


def temperature_at(times_s: Array, at_s: Array, celsius: Array) -> Array | None:
    """Return the (n,) temperatures at (n,) times; None if a time has no packet within NEAR_S."""
    temperatures_c = temperature_near(times_s, at_s, celsius)
    return temperatures_c if np.isfinite(temperatures_c).all() else None


def temperature_near(times_s: Array, at_s: Array, celsius: Array) -> Array:
    """Return the (n,) temperatures at (n,) times; NaN for times without a packet within NEAR_S."""
    if not len(at_s):
        return np.full(len(times_s), np.nan)
    index = np.clip(np.searchsorted(at_s, times_s), 1, max(1, len(at_s) - 1))
    last = np.minimum(index, len(at_s) - 1)
    gap = np.minimum(np.abs(at_s[last] - times_s), np.abs(at_s[index - 1] - times_s))
    return np.where(gap <= NEAR_S, np.interp(times_s, at_s, celsius), np.nan)


def _number(value: Any) -> float:
    """Return a value as a number; NaN if the packet does not contain it."""
    return math.nan if value is None else float(value)
