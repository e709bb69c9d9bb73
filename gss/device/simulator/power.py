"""Power of the unit: three switchable rails with their currents, and the temperatures. A latch-up raises the current of
a rail immediately. After ``trip_s`` the protection switches the rail off. The rail stays off until CLEAR_LATCHUP. Other
values correspond to a healthy unit and vary slowly with the orbit's day and night.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from gss.instruments.dictionary.definitions import Value
from gss.instruments.package_files import Currents, PowerRow

RAILS = ("imager", "fpga", "sram")
DAY_AND_NIGHT_S = 5700.0
SENSOR_C_PER_LSB, SENSOR_ZERO_C = 0.0625, -50.0
SENSOR_HOT_C, PROCESSOR_HOT_C, HYSTERESIS_C = 55.0, 75.0, 3.0
PROCESSOR_C_PER_LSB, PROCESSOR_MEAN, PROCESSOR_SWING, PROCESSOR_BUSY = 0.05, 1650, 90, 40


class Activity(StrEnum):
    """Activity of the unit: the modes of Erlank 2013 Table 6.2."""

    IDLE = "idle"
    STARTING = "starting"
    BUSY = "busy"
    COPYING = "copying"


@dataclass
class Rail:
    """One switched supply rail.

    ``latched``: True if the protection switched the rail off. ``short_since_s``: start of a latch-up while it draws
    current.
    """

    on: bool = True
    latched: bool = False
    short_since_s: float | None = None


class Power:
    """State of the rails at simulated times. ``row``: currents and reaction time of the instrument.

    ``pending_events``: events for the device to send, as (name, text)."""

    def __init__(self, row: PowerRow) -> None:
        self._row = row
        self._currents = {"imager": row.imager, "fpga": row.fpga, "sram": row.sram}
        self.rails = {name: Rail() for name in RAILS}
        self.latchups = 0
        self.offset_c = 0.0
        self.sensor_c = 12.0
        self._hot = False
        self.pending_events: list[tuple[str, str]] = []

    def restart(self) -> None:
        """Switch on every rail that is not latched up (reset)."""
        for rail in self.rails.values():
            rail.on = not rail.latched

    def switch(self, name: str, on: bool) -> bool:
        """Switch a rail (POWER). Returns True if its state changed. The caller must reject switching on a rail that
        latched up."""
        rail = self.rails[name]
        changed = rail.on != on
        rail.on = on
        if not on:
            rail.short_since_s = None
        return changed

    def latch_up(self, name: str, now_s: float) -> None:
        """Start a latch-up; this has no effect on a rail that is off."""
        rail = self.rails[name]
        if rail.on and rail.short_since_s is None:
            rail.short_since_s = now_s

    def clear(self, name: str) -> bool:
        """Switch a latched rail on again (CLEAR_LATCHUP). Returns True if the rail was latched up; otherwise nothing changes."""
        rail = self.rails[name]
        was = rail.latched or rail.short_since_s is not None
        if was:
            rail.on, rail.latched, rail.short_since_s = True, False, None
        return was

    def advance(self, now_s: float) -> list[str]:
        """Advance the time. Returns the rails that the protection has just switched off."""
        tripped = []
        for name, rail in self.rails.items():
            if rail.short_since_s is not None and now_s - rail.short_since_s >= self._row.trip_s:
                rail.on, rail.latched, rail.short_since_s = False, True, None
                self.latchups += 1
                tripped.append(name)
                drew = self._currents[name].latched / 10
                self.pending_events.append(("LATCHUP", f"{name} drew {drew:.0f} mA and was switched off"))
        return tripped

    def on(self, name: str) -> bool:
        """True if the rail has power."""
        return self.rails[name].on

    @property
    def latched(self) -> int:
        """Number of rails waiting for CLEAR_LATCHUP."""
        return sum(rail.latched for rail in self.rails.values())

    def values(self, now_s: float, activity: Activity, sensor_c: float) -> dict[str, Value]:
        """Return raw converter values for housekeeping. ``sensor_c``: the detector's temperature."""
        busy = activity is not Activity.IDLE
        swing = float(np.sin(2 * np.pi * now_s / DAY_AND_NIGHT_S))
        processor = (
            PROCESSOR_MEAN + PROCESSOR_SWING * swing + PROCESSOR_BUSY * busy + self.offset_c / PROCESSOR_C_PER_LSB
        )
        self._watch_heat(sensor_c, processor)
        values: dict[str, Value] = {
            "sensor_temperature_c": _raw((sensor_c - SENSOR_ZERO_C) / SENSOR_C_PER_LSB),
            "processor_temperature_c": _raw(processor),
            "supply_3v3_v": 3302 - 8 * busy - 25 * sum(r.short_since_s is not None for r in self.rails.values()),
            "current_processor_ma": _drawn(self._row.processor, activity),
        }
        for name, rail in self.rails.items():
            values[f"current_{name}_ma"] = self._current(name, rail, activity)
            values[f"{name}_on"] = rail.on
        return values | {"latchups": self.latchups & 0xFFFF, "latched_rails": self.latched}

    def _current(self, name: str, rail: Rail, activity: Activity) -> int:
        """Return the current of a rail in tenths of a milliampere."""
        currents = self._currents[name]
        if not rail.on:
            return round(self._row.off)
        return round(currents.latched) if rail.short_since_s is not None else _drawn(currents, activity)

    def _watch_heat(self, sensor_c: float, processor_raw: float) -> None:
        """Report overheating once; report it again only after the unit has cooled down."""
        processor_c = -60.0 + 0.05 * processor_raw + 1e-6 * processor_raw**2
        over_c = max(sensor_c - SENSOR_HOT_C, processor_c - PROCESSOR_HOT_C)
        if over_c > 0 and not self._hot:
            self._hot = True
            self.pending_events.append(("OVERHEAT", f"sensor {sensor_c:.0f} °C, processor {processor_c:.0f} °C"))
        elif over_c < -HYSTERESIS_C:
            self._hot = False


def _drawn(currents: Currents, activity: Activity) -> int:
    """Return the current of a healthy rail in tenths of a milliampere."""
    drawn = {
        Activity.BUSY: currents.busy,
        Activity.STARTING: currents.starting,
        Activity.COPYING: currents.copying,
    }.get(activity)
    return round(currents.idle if drawn is None else drawn)


def _raw(value: float) -> int:
    return int(np.clip(round(value), 0, 0xFFFF))
