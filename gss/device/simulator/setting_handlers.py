"""Handlers of the settings commands: exposure, gain, detection, attitude and orbit knowledge, time, period."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from gss.device.simulator.clock import DeviceClock
from gss.device.simulator.command_processor import Arguments, Handler, Returns
from gss.device.simulator.firmware import StarTracker
from gss.device.simulator.outbox import Outbox
from gss.device.simulator.rejection import Rejection
from gss.device.simulator.tracker_handlers import TrackerHandlers
from gss.pipeline.chains.apriori import Apriori, KnownOrbit

REMOVES_APRIORI_DEG = 180.0
"""SET_APRIORI with an uncertainty of at least this value removes the a-priori attitude."""


class SettingHandlers:
    """Handlers for tracker, cycle and clock settings. ``sky_s``: returns simulated seconds of the sky."""

    def __init__(
        self,
        tracker: StarTracker,
        cycle: TrackerHandlers,
        clock: DeviceClock,
        outbox: Outbox,
        sky_s: Callable[[], float],
    ) -> None:
        self._tracker, self._cycle, self._clock, self._outbox, self._sky_s = tracker, cycle, clock, outbox, sky_s

    def handlers(self) -> dict[str, Handler]:
        """Return the handlers by command name."""
        return {
            "SET_EXPOSURE": self.set_exposure,
            "SET_GAIN": self.set_gain,
            "SET_DETECTION": self.set_detection,
            "SET_FRAME_RATE": self.set_frame_rate,
            "SET_ATTITUDE_HINT": self.set_attitude_hint,
            "SET_ORBIT": self.set_orbit,
            "SET_APRIORI": self.set_apriori,
            "SET_TIME": self.set_time,
        }

    def set_exposure(self, arguments: Arguments, _: int) -> Returns:
        self._tracker.exposure_ms = int(arguments["exposure_ms"])
        return {}

    def set_detection(self, arguments: Arguments, _: int) -> Returns:
        low, high = int(arguments["min_pixels"]), int(arguments["max_pixels"])
        if low > high:
            raise Rejection("out_of_range", f"smallest region {low} is above the largest {high}")
        tracker = self._tracker
        tracker.threshold_dn, tracker.min_pixels, tracker.max_pixels = int(arguments["threshold_dn"]), low, high
        return {}

    def set_attitude_hint(self, arguments: Arguments, _: int) -> Returns:
        names = ("ra_deg", "dec_deg", "roll_deg", "uncertainty_deg")
        ra_rad, dec_rad, roll_rad, radius_rad = (float(np.radians(float(arguments[n]))) for n in names)
        self._tracker.set_hint(ra_rad, dec_rad, roll_rad, radius_rad)
        return {}

    def set_gain(self, arguments: Arguments, _: int) -> Returns:
        self._tracker.imager.gain = int(arguments["gain"])
        return {}

    def set_frame_rate(self, arguments: Arguments, _: int) -> Returns:
        self._cycle.period_ms = int(arguments["period_ms"])
        return {}

    def set_orbit(self, arguments: Arguments, _: int) -> Returns:
        names = ("raan_deg", "inclination_deg", "latitude_deg")
        raan_rad, inclination_rad, latitude_rad = (float(np.radians(float(arguments[n]))) for n in names)
        altitude_m = 1000.0 * float(arguments["altitude_km"])
        orbit = KnownOrbit(raan_rad, inclination_rad, latitude_rad, altitude_m, float(arguments["epoch_s"]))
        self._tracker.prior = replace(self._tracker.prior, orbit=orbit)
        return {}

    def set_apriori(self, arguments: Arguments, _: int) -> Returns:
        if float(arguments["uncertainty_deg"]) >= REMOVES_APRIORI_DEG:
            self._tracker.prior = replace(self._tracker.prior, apriori=None)
            return {}
        names = ("roll_deg", "pitch_deg", "yaw_deg", "uncertainty_deg")
        roll_rad, pitch_rad, yaw_rad, radius_rad = (float(np.radians(float(arguments[n]))) for n in names)
        apriori = Apriori(roll_rad, pitch_rad, yaw_rad, radius_rad)
        self._tracker.prior = replace(self._tracker.prior, apriori=apriori)
        return {}

    def set_time(self, arguments: Arguments, request_id: int) -> Returns:
        self._clock.set_utc(float(arguments["utc_s"]), self._sky_s())
        self._outbox.event("TIME_SET", f"{float(arguments['utc_s']):.3f} s since 1970", request_id)
        return {}
