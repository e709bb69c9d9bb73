"""Standard quantities, mapped to an instrument's telemetry fields. An empty name means that the instrument does not
report the quantity.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import lru_cache
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, field_validator

from gss.domain.angles import Array
from gss.domain.rotation import quaternion_from_matrix
from gss.instruments.dictionary.definitions import Group, Item, PacketDefinition, Value
from gss.instruments.quantities import Strict

Name = Annotated[str, Field(max_length=60)]
Axes = tuple[Name, Name, Name, Name]
Quaternion = tuple[float, float, float, float]
AxisName = Literal["+x", "+y", "+z", "-x", "-y", "-z"]
CAMERA_AXES = ("+x", "+y", "+z")
NOT_A_FIELD = ("packet", "order", "rotation", "camera_axes", "entry")
LONGEST_CHOICE = {("FrameInfo", "mode"): 20, ("BankInfo", "bank"): 12, ("BankInfo", "state"): 12}
"""Longest names of choices that the database can store, by role and quantity."""
UNITS = {"_ms": "ms", "_deg": "deg", "_arcsec": "arcsec", "_dn": "DN", "_deg_s": "deg/s", "_s": "s"}
"""Unit of a quantity by the suffix of its name. If the sensor uses another unit, the dictionary must define a
conversion."""


class PacketRole(Strict):
    """A packet with a standard purpose. Each attribute except ``packet`` is a standard quantity; its value is the
    name of the packet's field."""

    packet: Name = ""

    def fields(self) -> dict[str, str]:
        """Return the packet's field names by quantity, omitting quantities that are not reported."""
        names: dict[str, str] = {}
        for name, value in self.model_dump(exclude=set(NOT_A_FIELD)).items():
            values = value if isinstance(value, tuple) else (value,)
            names |= {name if len(values) == 1 else f"{name}.{k}": v for k, v in enumerate(values) if v}
        return names

    def read(self, values: Mapping[str, Value]) -> dict[str, Value]:
        """Return the values of a packet by standard quantity, omitting quantities that the instrument does not
        report."""
        return {quantity: values[name] for quantity, name in self.fields().items() if name in values}


def _axes_matrix(axes: tuple[str, str, str]) -> Array:
    """Return the (3, 3) rotation matrix from the sensor frame to the camera frame."""
    rows = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}
    return np.array([np.array(rows[axis[1]]) * (-1 if axis[0] == "-" else 1) for axis in axes])


@lru_cache(maxsize=24)
def _axes_quaternion(axes: tuple[str, str, str]) -> Quaternion:
    x, y, z, w = (float(q) for q in quaternion_from_matrix(_axes_matrix(axes)))
    return x, y, z, w


def _product(a: Quaternion, b: Quaternion) -> Quaternion:
    """Return the Hamilton product of two scalar-last quaternions."""
    (ax, ay, az, aw), (bx, by, bz, bw) = a, b
    return (
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
        aw * bw - ax * bx - ay * by - az * bz,
    )


class Status(PacketRole):
    """State of the sensor, sent at regular intervals and on request."""

    mode: Name = ""
    cycle_running: Name = ""
    iteration: Name = ""
    uptime_s: Name = ""
    active_bank: Name = ""
    confirm_left_s: Name = ""
    catalogue_sha256: Name = ""
    exposure_ms: Name = ""
    threshold_dn: Name = ""
    min_pixels: Name = ""
    max_pixels: Name = ""
    background_dn: Name = ""
    regions_invalid: Name = ""
    centroids_found: Name = ""
    stars_matched: Name = ""
    match_confidence: Name = ""
    attitude_age_s: Name = ""
    sigma_cross_arcsec: Name = ""
    rate_deg_s: Name = ""
    sensor_temperature: Name = ""
    processor_temperature: Name = ""
    supply_voltage: Name = ""
    imager_current: Name = ""


class AttitudeRole(PacketRole):
    """Attitude of one frame. ``quaternion``: names of its four components; ``order``: position of the scalar;
    ``rotation``: direction of the rotation, target from source. ``camera_axes``: axes of the sensor frame that
    correspond to the camera axes x (towards higher columns), y (towards higher rows) and z (boresight)."""

    frame_number: Name = ""
    frame_time_s: Name = ""
    mode: Name = ""
    outcome: Name = ""
    quaternion: Axes = ("", "", "", "")
    order: Literal["scalar_last", "scalar_first"] = "scalar_last"
    rotation: Literal["cam_from_icrs", "icrs_from_cam"] = "cam_from_icrs"
    camera_axes: tuple[AxisName, AxisName, AxisName] = ("+x", "+y", "+z")
    ra_deg: Name = ""
    dec_deg: Name = ""
    roll_deg: Name = ""
    sigma_cross_arcsec: Name = ""
    sigma_roll_arcsec: Name = ""
    centroids: Name = ""
    matched: Name = ""
    match_confidence: Name = ""
    reason: Name = ""

    def quaternion_of(self, values: Mapping[str, float]) -> tuple[float, float, float, float]:
        """Return the quaternion cam_from_icrs, scalar-last. Raises KeyError if the values lack a component."""
        a, b, c, d = (float(values[name]) for name in self.quaternion)
        x, y, z, w = (b, c, d, a) if self.order == "scalar_first" else (a, b, c, d)
        cam_or_sensor = (x, y, z, w) if self.rotation == "cam_from_icrs" else (-x, -y, -z, w)
        return cam_or_sensor if self.camera_axes == CAMERA_AXES else _product(self.cam_from_own, cam_or_sensor)

    @property
    def cam_from_own(self) -> Quaternion:
        """Quaternion of the rotation from the sensor frame to the camera frame, scalar-last."""
        return _axes_quaternion(self.camera_axes)

    @field_validator("camera_axes")
    @classmethod
    def _is_rotation(cls, axes: tuple[str, str, str]) -> tuple[str, str, str]:
        if round(float(np.linalg.det(_axes_matrix(axes)))) != 1:
            raise ValueError("must be three different axes of a right-handed frame")
        return axes

    def read(self, values: Mapping[str, Value]) -> dict[str, Value]:
        """Return the values by standard quantity, with the components of cam_from_icrs as ``quaternion_x`` to
        ``quaternion_w``."""
        by_quantity = {name: value for name, value in super().read(values).items() if not name.startswith("quaternion")}
        if all(name in values for name in self.quaternion):
            components = self.quaternion_of({name: float(values[name]) for name in self.quaternion})
            by_quantity |= {f"quaternion_{axis}": value for axis, value in zip("xyzw", components, strict=True)}
        return by_quantity


class StarEntry(Strict):
    """Fields of one entry of a list of measured stars. ``unit`` of ``column`` and ``row``: pixels, or millimetres from the
    centre of the detector. Brightness is reported as ``flux`` or as ``magnitude``, in any unit."""

    column: Name
    row: Name
    unit: Literal["px", "mm"] = "px"
    flux: Name = ""
    magnitude: Name = ""

    def names(self) -> tuple[str, ...]:
        """Return the names of the fields."""
        return tuple(name for name in (self.column, self.row, self.flux, self.magnitude) if name)


class ItemList(PacketRole):
    """A list with one entry per star or byte. ``entry``: fields of an entry, if the entries are measured stars."""

    frame_number: Name = ""
    items: Name = ""
    entry: StarEntry | None = None
    regions_invalid: Name = ""
    background_dn: Name = ""


class TimingRole(PacketRole):
    """Duration of each stage of one iteration."""

    iteration: Name = ""
    frame_number: Name = ""
    capture_ms: Name = ""
    transfer_ms: Name = ""
    detect_ms: Name = ""
    match_ms: Name = ""
    attitude_ms: Name = ""


class FrameInfo(PacketRole):
    """Content of one image memory. If the sensor does not number its frames, the frame time is used as the frame
    number."""

    frame_number: Name = ""
    slot: Name = ""
    source: Name = ""
    exposure_ms: Name = ""
    frame_time_s: Name = ""
    columns: Name = ""
    rows: Name = ""
    bits: Name = ""
    mode: Name = ""
    sha256: Name = ""

    @property
    def number_is_time(self) -> bool:
        """True if the frame number is the frame time, so that each number is unique."""
        return bool(self.frame_number) and self.frame_number == self.frame_time_s


class BankInfo(PacketRole):
    """Content of one catalogue bank or table bank."""

    table: Name = ""
    bank: Name = ""
    state: Name = ""
    active: Name = ""
    size_bytes: Name = ""
    capacity_bytes: Name = ""
    write_protected: Name = ""
    stars: Name = ""
    pairs: Name = ""
    epoch_jyear: Name = ""
    format_version: Name = ""
    profile: Name = ""
    confirm_left_s: Name = ""
    sha256: Name = ""


class ScheduleEntryRole(PacketRole):
    """One scheduled command."""

    schedule_id: Name = ""
    at_s: Name = ""
    command_code: Name = ""
    length: Name = ""
    payload: Name = ""
    state: Name = ""
    reason: Name = ""


class Quantities(Strict):
    """Packets of an instrument by purpose."""

    status: Status = Status()
    attitude: AttitudeRole = AttitudeRole()
    truth: AttitudeRole = AttitudeRole()
    centroids: ItemList = ItemList()
    matches: ItemList = ItemList()
    timing: TimingRole = TimingRole()
    frame: FrameInfo = FrameInfo()
    bank: BankInfo = BankInfo()
    table: BankInfo = BankInfo()
    schedule_entry: ScheduleEntryRole = ScheduleEntryRole()

    def roles(self) -> dict[str, PacketRole]:
        """Return the roles whose packet the instrument has, by purpose."""
        all_roles = {name: getattr(self, name) for name in type(self).model_fields}
        return {name: role for name, role in all_roles.items() if role.packet}

    def names(self) -> tuple[str, ...]:
        """Return the quantities that the instrument reports, each as ``purpose.quantity``."""
        return tuple(f"{purpose}.{name}" for purpose, role in self.roles().items() for name in role.fields())


class Events(Strict):
    """Events of an instrument by purpose."""

    boot: Name = ""
    time_set: Name = ""
    clock_jump: Name = ""
    bank_activated: Name = ""
    bank_confirmed: Name = ""
    bank_fell_back: Name = ""
    table_fell_back: Name = ""
    schedule_run: Name = ""
    schedule_failed: Name = ""


def check_packet(role: PacketRole, packets: Mapping[str, PacketDefinition]) -> tuple[tuple[str, ...], str] | None:
    """Return the path in the role and the reason of the first error; None if the role matches the dictionary."""
    if role.packet not in packets:
        return ("packet",), f"the dictionary has no packet {role.packet or '(empty)'}"
    layout = {f.name: f for f in packets[role.packet].fields}
    for quantity, name in role.fields().items():
        if name not in layout:
            return (quantity.split(".")[0],), f"{role.packet} has no field {name}"
        field, unit = layout[name], _unit(quantity)
        longest = LONGEST_CHOICE.get((type(role).__name__, quantity), math.inf)
        for choice in field.choices if isinstance(field, Item) else ():
            if len(choice.name) > longest:
                return (quantity,), f"the choice {choice.name} of {name} has more than {longest} characters"
        if not isinstance(field, Group) and unit and field.unit and field.unit != unit:
            return (quantity,), f"{name} is in {field.unit}, not {unit}; give the field a conversion in the dictionary"
    if isinstance(role, ItemList) and role.entry is not None:
        items = layout.get(role.items)
        if not isinstance(items, Group):
            return ("items",), f"{role.packet} has no list {role.items or '(empty)'}"
        missing = [name for name in role.entry.names() if name not in {i.name for i in items.items}]
        if missing:
            return ("entry",), f"the entries of {role.items} have no field {missing[0]}"
    return None


def _unit(quantity: str) -> str:
    return next((unit for suffix, unit in UNITS.items() if quantity.endswith(suffix)), "")
