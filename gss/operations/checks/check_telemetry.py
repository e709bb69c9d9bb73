"""Checks that telemetry values are physically possible. Warning limits are not checked, because a warm sensor does not violate
the interface."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping

import numpy as np

from gss.device.protocol.codec import Decoded
from gss.domain.frames import cam_from_icrs
from gss.domain.rotation import matrix_from_quaternion, rotation_angle_rad
from gss.instruments.dictionary.definitions import PacketDefinition, TelemetryField, Value

BY_NAME: tuple[tuple[str, tuple[float, float]], ...] = (
    ("quaternion_", (-1.000001, 1.000001)),
    ("dec_deg", (-90.0, 90.0)),
    ("ra_deg", (0.0, 360.0)),
    ("roll_deg", (0.0, 360.0)),
)
BY_UNIT = {"%": (0.0, 100.0), "s": (0.0, math.inf), "arcsec": (0.0, math.inf), "DN": (0.0, 65535.0)}
UNIT_NORM_WITHIN = 1e-4
SAME_WITHIN_RAD = 2e-4
"""Largest permitted rotation between a quaternion and the angles in the same packet."""


def possible_range(field: TelemetryField) -> tuple[float, float]:
    """Return the lowest and highest possible value of a field. The name, the unit or the critical limits of the field
    determine them."""
    for start, bounds in BY_NAME:
        if field.name.startswith(start):
            return bounds
    if field.name.endswith(("temperature_c", "_v", "_ma")):
        low, high = field.limits.critical
        return -math.inf if low is None else low, math.inf if high is None else high
    return BY_UNIT.get(field.unit, (-math.inf, math.inf))


def problems(row: PacketDefinition, message: Decoded) -> Iterator[str]:
    """Yield a text for each impossible value of a packet. NaN is accepted and means unknown."""
    for field in row.values:
        value = message.values[field.name]
        if isinstance(value, bool) or not isinstance(value, int | float) or math.isnan(value):
            continue
        low, high = possible_range(field)
        if not low <= value <= high:
            yield f"{field.name}: {low:g} – {high:g}, got {value:g}"
    quaternion = [message.values[n] for n in (f"quaternion_{c}" for c in "xyzw") if n in message.values]
    if len(quaternion) == 4 and not _unit_or_unknown(quaternion):
        yield f"quaternion is not a rotation: {quaternion}"
    elif len(quaternion) == 4:
        yield from _other_angles(message.values)


def _other_angles(values: Mapping[str, Value]) -> Iterator[str]:
    """Yield a text if boresight and roll do not agree with the quaternion (docs/conventions.md)."""
    names = ("quaternion_x", "quaternion_y", "quaternion_z", "quaternion_w", "ra_deg", "dec_deg", "roll_deg")
    if not all(name in values for name in names):
        return
    numbers = np.array([float(values[name]) for name in names])
    if np.isnan(numbers).any():
        return
    stated = cam_from_icrs(*np.radians(numbers[4:]))
    error_rad = rotation_angle_rad(matrix_from_quaternion(numbers[:4]), stated)
    if error_rad > SAME_WITHIN_RAD:
        yield f"quaternion and ra_deg, dec_deg, roll_deg differ by {np.degrees(error_rad):.3g}°"


def _unit_or_unknown(parts: list[Value]) -> bool:
    numbers = [float(p) for p in parts if not isinstance(p, str | bytes)]
    if any(map(math.isnan, numbers)):
        return True
    return abs(math.hypot(*numbers) - 1.0) <= UNIT_NORM_WITHIN
