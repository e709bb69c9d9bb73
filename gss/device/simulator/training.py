"""Fault injection for training: immediate, for a duration, or by a seeded plan; line faults; motion of the sky."""

from __future__ import annotations

import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from gss.device.simulator.clock import DeviceClock
from gss.device.simulator.command_processor import Arguments, Handler, Returns
from gss.device.simulator.firmware import StarTracker
from gss.device.simulator.memory import BANKS, Memory
from gss.device.simulator.orbit import Inertial
from gss.device.simulator.outbox import Outbox
from gss.device.simulator.power import Power
from gss.device.simulator.rejection import Rejection
from gss.domain.errors import BadInput

LASTING = ("stuck_sensor", "overheat", "stale_attitude", "clock_drift", "blinded", "false_stars", "hot_pixels")
"""Faults that last for their duration or until they are removed. All other faults occur once."""
LIMITS: Mapping[str, tuple[float, float]] = {
    "bank_corruption": (0, len(BANKS) - 1),
    "overheat": (-100.0, 150.0),
    "clock_drift": (-100_000.0, 100_000.0),
    "clock_jump": (-1.0e6, 1.0e6),
    "false_stars": (1, 500),
    "hot_pixels": (1, 100),
}
USUAL: Mapping[str, float] = {
    "overheat": 30.0,
    "clock_drift": 100.0,
    "clock_jump": 10.0,
    "false_stars": 20.0,
    "hot_pixels": 20.0,
}
"""Default sizes of faults, in °C, parts per million, seconds, stars or groups of pixels. They replace the value
0, which would have no effect."""
FLIPPED_BITS = 3
CONTROL = {"orbit": "zenith", "inertial": "inertial", "slew": "slew", "tumble": "tumble", "earth_fixed": "ground"}
STALL_S = 0.5


@dataclass(frozen=True)
class PlannedFault:
    """A planned fault. ``at_s``: simulated seconds of the sky. ``duration_s`` 0: until removed."""

    at_s: float
    fault: str
    value: float = 0.0
    duration_s: float = 0.0


class Training:
    """Handlers and timing of faults. ``sky_s``: returns the simulated time of the sky in seconds. ``reset``: requests a
    watchdog reset."""

    def __init__(
        self,
        tracker: StarTracker,
        memory: Memory,
        power: Power,
        clock: DeviceClock,
        outbox: Outbox,
        sky_s: Callable[[], float],
        reset: Callable[[], None],
    ) -> None:
        self._tracker, self._memory, self._power, self._clock = tracker, memory, power, clock
        self._outbox, self._sky_s, self._reset = outbox, sky_s, reset
        self._until_s: dict[str, float | None] = {}
        self._plan: list[PlannedFault] = []

    def handlers(self) -> dict[str, Handler]:
        """Return the handlers by command name. Real units do not have these commands."""
        return {
            "SIM_INJECT": self.sim_inject,
            "SIM_SET_LINE": self.sim_set_line,
            "SIM_DISCONNECT": self.sim_disconnect,
            "SIM_SET_SKY": self.sim_set_sky,
        }

    @property
    def at_work(self) -> int:
        """Number of lasting faults that are active."""
        return len(self._until_s)

    # --- faults -------------------------------------------------------------------------------------------------

    def plan(self, faults: tuple[PlannedFault, ...]) -> None:
        """Add faults that start automatically at their planned times."""
        self._plan = sorted([*self._plan, *faults], key=lambda f: f.at_s)

    def advance(self) -> None:
        """Start planned faults and end lasting faults that are due."""
        now_s = self._sky_s()
        while self._plan and self._plan[0].at_s <= now_s:
            planned = self._plan.pop(0)
            try:
                self.inject(planned.fault, planned.value, planned.duration_s)
            except Rejection as rejection:
                self._outbox.event("TRAINING", f"{planned.fault} was not injected: {rejection.detail}")
        for fault in [f for f, until_s in self._until_s.items() if until_s is not None and now_s >= until_s]:
            self._end(fault)
            self._outbox.event("TRAINING", f"{fault} ended")

    def inject(self, fault: str, value: float = 0.0, duration_s: float = 0.0, request_id: int = 0) -> None:
        """Inject a fault now; value 0 uses its default size. "none" removes all faults.

        Raises Rejection if the value is out of range.
        """
        value = value or USUAL.get(fault, 0.0)
        if fault in LIMITS:
            low, high = LIMITS[fault]
            if not low <= value <= high:
                raise Rejection("out_of_range", f"{fault}: {low:g} – {high:g}, got {value:g}")
        self._outbox.event("TRAINING", _sentence(fault, value, duration_s), request_id)
        if fault == "none":
            for lasting in list(self._until_s):
                self._end(lasting)
            self._plan.clear()
        elif fault in LASTING:
            self._begin(fault, value)
            self._until_s[fault] = self._sky_s() + duration_s if duration_s > 0 else None
        else:
            self._apply_once(fault, value, request_id)

    def _apply_once(self, fault: str, value: float, request_id: int) -> None:
        if fault.startswith("latchup_"):
            self._power.latch_up(fault.removeprefix("latchup_"), self._sky_s())
        elif fault == "reset":
            self._reset()
        elif fault == "flash_failure":
            self._memory.flash.fail_next = True
        elif fault == "bank_corruption":
            self._corrupt(BANKS[int(value)])
        elif fault == "clock_jump":
            jumped_s = self._clock.jump(value, self._sky_s())
            self._outbox.event("CLOCK_JUMP", f"{jumped_s:+.1f} s", request_id)

    def _corrupt(self, bank: str) -> None:
        size = self._memory.record.banks[bank].size
        if not size:
            raise Rejection("bank_empty", f"bank {bank} is empty")
        # Other bits of a content that is already corrupt, so that a second corruption does not repair the first.
        rng = np.random.default_rng(zlib.crc32(self._memory.content(bank)))
        for at in rng.choice(size, FLIPPED_BITS, replace=False):
            self._memory.flash.flip(self._memory.offset(bank) + int(at), int(rng.integers(8)))

    def _begin(self, fault: str, value: float) -> None:
        flaws = self._tracker.imager.faults
        if fault == "stuck_sensor":
            flaws.stuck = True
        elif fault == "blinded":
            flaws.blinded = True
        elif fault == "false_stars":
            flaws.dots = int(value)
        elif fault == "hot_pixels":
            self._tracker.sky.environment.set_hot_pixels(int(value))
        elif fault == "stale_attitude":
            self._tracker.stale = True
        elif fault == "clock_drift":
            self._clock.set_drift(value, self._sky_s())
        else:
            self._heat(value)

    def _end(self, fault: str) -> None:
        self._until_s.pop(fault, None)
        flaws = self._tracker.imager.faults
        if fault == "stuck_sensor":
            flaws.stuck = False
        elif fault == "blinded":
            flaws.blinded = False
        elif fault == "false_stars":
            flaws.dots = 0
        elif fault == "hot_pixels":
            self._tracker.sky.environment.set_hot_pixels(0)
        elif fault == "stale_attitude":
            self._tracker.stale = False
        elif fault == "clock_drift":
            self._clock.set_drift(0.0, self._sky_s())
        else:
            self._heat(0.0)

    def _heat(self, offset_c: float) -> None:
        self._power.offset_c = offset_c
        self._tracker.sky.environment.temperature_offset_c = offset_c

    # --- commands -----------------------------------------------------------------------------------------------

    def sim_inject(self, arguments: Arguments, request_id: int) -> Returns:
        self.inject(str(arguments["fault"]), float(arguments["value"]), float(arguments["duration_s"]), request_id)
        return {}

    def sim_set_line(self, arguments: Arguments, request_id: int) -> Returns:
        names = ("bit_error_rate", "burst_rate", "drop_rate", "duplicate_rate", "stall_rate")
        rates = {n: float(arguments[n]) for n in names}
        line = self._tracker.sky.environment.line
        try:
            line.set(
                direction=str(arguments["direction"]),
                delay_s=float(arguments["delay_ms"]) / 1000,
                stall_s=STALL_S,
                **rates,
            )
        except BadInput as error:
            raise Rejection("out_of_range", str(error)) from error
        self._outbox.event(
            "TRAINING", f"line {arguments['direction']!s}: bit error rate {rates['bit_error_rate']:g}", request_id
        )
        return {}

    def sim_disconnect(self, arguments: Arguments, request_id: int) -> Returns:
        seconds = float(arguments["duration_s"])
        try:
            self._tracker.sky.environment.line.disconnect(seconds)
        except BadInput as error:
            raise Rejection("out_of_range", str(error)) from error
        self._outbox.event("TRAINING", f"the port is disconnected for {seconds:.1f} s", request_id)
        return {}

    def sim_set_sky(self, arguments: Arguments, request_id: int) -> Returns:
        """Set the motion. It starts at the attitude in the arguments; "orbit" returns to the orbit instead."""
        world, now_s, kind = self._tracker.sky.environment, self._sky_s(), str(arguments["motion"])
        if kind != "orbit":
            ra_rad, dec_rad, roll_rad = (
                float(np.radians(float(arguments[n]))) for n in ("ra_deg", "dec_deg", "roll_deg")
            )
            world.motion = Inertial.pointing(ra_rad, dec_rad, roll_rad)
        try:
            world.set_motion(CONTROL[kind], now_s, rate_rad_s=float(np.radians(float(arguments["rate_deg_s"]))))
        except BadInput as error:
            raise Rejection("out_of_range", str(error)) from error
        self._outbox.event("TRAINING", f"motion: {kind}", request_id)
        return {}


def _sentence(fault: str, value: float, duration_s: float) -> str:
    if fault == "none":
        return "all faults are removed"
    how_much = f" {value:g}" if fault in LIMITS else ""
    how_long = f" for {duration_s:g} s" if fault in LASTING and duration_s > 0 else ""
    return f"{fault}{how_much}{how_long}"
