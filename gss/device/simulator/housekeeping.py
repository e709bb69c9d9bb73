"""Housekeeping packet: values of all parts of the unit, collected once per second."""

from __future__ import annotations

import math

import numpy as np

from gss.device.protocol.receiver import LineReceiver
from gss.device.simulator.bank_handlers import BankHandlers
from gss.device.simulator.command_processor import CommandProcessor, Returns
from gss.device.simulator.firmware import StarTracker
from gss.device.simulator.loader import Loader
from gss.device.simulator.memory import TABLES, Memory
from gss.device.simulator.power import Activity, Power
from gss.device.simulator.reports import pose_values, timing_values
from gss.device.simulator.schedule import Schedule
from gss.device.simulator.tracker_handlers import TrackerHandlers
from gss.domain.angles import ARCSEC_RAD

UNKNOWN = float("nan")


class Housekeeper:
    """Collects the housekeeping values. The only side effect is the overheat check of Power."""

    def __init__(
        self,
        tracker: StarTracker,
        memory: Memory,
        power: Power,
        processor: CommandProcessor,
        receiver: LineReceiver,
        loader: Loader,
        cycle: TrackerHandlers,
        banks: BankHandlers,
        schedule: Schedule,
    ) -> None:
        self._tracker, self._memory, self._power, self._processor, self._receiver = (
            tracker,
            memory,
            power,
            processor,
            receiver,
        )
        self._loader, self._cycle, self._banks, self._schedule = loader, cycle, banks, schedule

    def values(self, sky_s: float, time_s: float, uptime_s: float) -> Returns:
        """Return the values of the packet: raw for fields with a conversion, otherwise in engineering units.

        ``sky_s``: simulated time, ``time_s``: device time.
        """
        activity = Activity.BUSY if self._processor.busy else self._cycle.activity
        sensor_c = self._tracker.sky.environment.sensor_temperature_c(sky_s)
        return (
            self._attitude(sky_s, time_s)
            | self._settings()
            | self._unit(uptime_s)
            | self._flash()
            | self._power.values(sky_s, activity, sensor_c)
        )

    def _attitude(self, sky_s: float, time_s: float) -> Returns:
        tracker = self._tracker
        values: Returns = {
            "mode": tracker.mode,
            "tracking_state": tracker.mode if tracker.mode in ("tracking", "assisted") else "lost",
            "cycle_running": self._cycle.cycle_running,
            "iteration": tracker.iteration,
            "attitude_age_s": max(0.0, time_s - tracker.attitude_time_s)
            if tracker.attitude_time_s is not None
            else math.nan,
            "centroids_found": min(255, len(tracker.detection.centroids)) if tracker.detection else 0,
            "regions_invalid": min(255, tracker.detection.invalid) if tracker.detection else 0,
            "stars_matched": tracker.matched,
            "match_confidence": 100.0 * tracker.matching.confidence if tracker.matching is not None else 0.0,
            "sigma_cross_arcsec": tracker.sigma_rad[0] / ARCSEC_RAD,
            "sigma_roll_arcsec": tracker.sigma_rad[1] / ARCSEC_RAD,
            "rate_deg_s": float(np.degrees(tracker.prior.rate_rad_s)),
            "background_dn": float(tracker.detection.black_dn) if tracker.detection else math.nan,
            "orbit_known": tracker.prior.orbit is not None,
        }
        return values | timing_values(tracker.timing) | pose_values(tracker.quaternion)

    def _settings(self) -> Returns:
        tracker = self._tracker
        return {
            "exposure_ms": tracker.exposure_ms,
            "threshold_dn": tracker.threshold_dn,
            "min_pixels": tracker.min_pixels,
            "max_pixels": tracker.max_pixels,
            "gain": tracker.imager.gain,
            "period_ms": self._cycle.period_ms,
        }

    def _unit(self, uptime_s: float) -> Returns:
        record, waiting = self._memory.record, self._schedule.waiting
        return {
            "last_frame": record.frames,
            "resets": record.resets & 0xFFFF,
            "reset_cause": record.reset_cause,
            "uptime_s": int(uptime_s),
            "time_set": record.utc_offset_s is not None,
            "scheduled": len(waiting),
            "next_scheduled_s": waiting[0].at_s if waiting else UNKNOWN,
            "commands_accepted": self._processor.accepted & 0xFFFF,
            "commands_rejected": self._processor.rejected & 0xFFFF,
            "frames_good": self._receiver.good,
            "frames_bad": self._receiver.bad_total,
            "transfer_sessions": self._loader.open_sessions,
        }

    def _flash(self) -> Returns:
        record = self._memory.record
        bank = record.banks[record.active]
        values: Returns = {
            "flash_used_bytes": self._memory.used_bytes,
            "active_bank": record.active,
            "active_valid": self._tracker.catalogue is not None,
            "catalogue_stars": bank.stars,
            "catalogue_pairs": bank.pairs,
            "catalogue_sha256": bytes.fromhex(bank.sha256) if bank.sha256 else bytes(32),
            "confirm_left_s": self._banks.confirm_left_s,
        }
        return values | {f"{table}_bank": record.tables[table].active for table in TABLES}
