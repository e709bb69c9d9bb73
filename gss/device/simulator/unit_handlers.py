"""Handlers of the commands for power and memory: POWER, CLEAR_LATCHUP, READ_MEMORY."""

from __future__ import annotations

from collections.abc import Callable

from gss.device.simulator.command_processor import Arguments, Handler, Returns, Task
from gss.device.simulator.firmware import StarTracker
from gss.device.simulator.images import SLOTS
from gss.device.simulator.loader import Loader
from gss.device.simulator.memory import Memory
from gss.device.simulator.outbox import Outbox
from gss.device.simulator.power import Power
from gss.device.simulator.rejection import Rejection
from gss.device.simulator.tracker_handlers import TrackerHandlers

SWITCH_S = 0.1


class UnitHandlers:
    """Handlers of the power and memory commands. ``registers``: returns settings and counters as bytes."""

    def __init__(
        self,
        power: Power,
        tracker: StarTracker,
        cycle: TrackerHandlers,
        loader: Loader,
        memory: Memory,
        outbox: Outbox,
        registers: Callable[[], bytes],
    ) -> None:
        self._power, self._tracker, self._cycle, self._loader = power, tracker, cycle, loader
        self._memory, self._outbox, self._registers = memory, outbox, registers

    def handlers(self) -> dict[str, Handler]:
        """Return the handlers by command name."""
        return {"POWER": self.power, "CLEAR_LATCHUP": self.clear_latchup, "READ_MEMORY": self.read_memory}

    def power(self, arguments: Arguments, request_id: int) -> Task:
        rail, on = str(arguments["rail"]), arguments["state"] == "on"
        yield SWITCH_S
        if on and self._power.rails[rail].latched:
            raise Rejection("wrong_state", f"{rail} latched up: send CLEAR_LATCHUP to switch it on again")
        if self._power.switch(rail, on):
            self._outbox.event("POWER_CHANGED", f"{rail} {'on' if on else 'off'}", request_id)
            self.apply()
        return {}

    def clear_latchup(self, arguments: Arguments, request_id: int) -> Task:
        rail = str(arguments["rail"])
        yield SWITCH_S
        if self._power.clear(rail):
            self._outbox.event("LATCHUP_CLEARED", rail, request_id)
        return {}

    def apply(self) -> None:
        """Apply the effects of missing power: image memories are emptied, image transfers and the cycle stop."""
        if not self._power.on("sram"):
            self._tracker.slots.clear()
            self._loader.drop_images()
        self._cycle.stop_without_power()

    def read_memory(self, arguments: Arguments, request_id: int) -> Returns:
        area, address, length = str(arguments["area"]), int(arguments["address"]), int(arguments["length"])
        if area == "sram" and not self._power.on("sram"):
            raise Rejection("powered_off", "sram has no power")
        registers = self._registers()
        sizes = {
            "flash": len(self._memory.flash),
            "sram": SLOTS * self._tracker.imager.frame_size,
            "registers": len(registers),
        }
        if address + length > sizes[area]:
            raise Rejection("out_of_range", f"{area} has {sizes[area]} B, requested {address} – {address + length - 1}")
        if area == "flash":
            data = self._memory.flash.read(address, length)
        elif area == "sram":
            data = self._tracker.imager.sram(address, length)
        else:
            data = registers[address : address + length]
        values: Returns = {"area": area, "address": address}
        self._outbox.telemetry(("memory", values, {"items": [{"byte": b} for b in data]}), request_id)
        return {}
