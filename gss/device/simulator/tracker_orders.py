"""What the commands for images, stars and attitude do, and the 1 Hz cycle."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from gss.device.simulator.command_desk import Arguments, CommandDesk, Handler, Returns, Task
from gss.device.simulator.firmware import STANDBY, Refusal, StarTracker
from gss.device.simulator.outbox import Outbox
from gss.device.simulator.reports import frame_report, truth_report

CYCLE_S = 1.0
CYCLE_SLOTS = (2, 3)
LONGEST_CYCLE_EXPOSURE_MS = 500


class TrackerOrders:
    """Handlers over a StarTracker. ``clock``: (simulated time, device time)."""

    def __init__(
        self, tracker: StarTracker, outbox: Outbox, desk: CommandDesk, clock: Callable[[], tuple[float, float]]
    ) -> None:
        self._tracker, self._outbox, self._desk, self._clock = tracker, outbox, desk, clock
        self._due_s: float | None = None
        self._last_slot: int | None = None

    def handlers(self) -> dict[str, Handler]:
        """By command name."""
        return {
            "SET_MODE": self.set_mode,
            "START_CYCLE": self.start_cycle,
            "STOP_CYCLE": self.stop_cycle,
            "RUN_ITERATION": self.run_iteration,
            "TAKE_IMAGE": self.take_image,
            "LIST_FRAMES": self.list_frames,
            "SET_EXPOSURE": self.set_exposure,
            "SET_DETECTION": self.set_detection,
            "SET_ATTITUDE_HINT": self.set_attitude_hint,
            "FIND_CENTROIDS": self.find_centroids,
            "MATCH_STARS": self.match_stars,
            "CALCULATE_ATTITUDE": self.calculate_attitude,
        }

    # --- cycle --------------------------------------------------------------------------------------------------

    @property
    def cycle_running(self) -> bool:
        """Does the cycle run?"""
        return self._due_s is not None

    def restart(self) -> bool:
        """Forget the cycle without a word; True if it ran."""
        ran = self.cycle_running
        self._due_s = self._last_slot = None
        return ran

    def run_cycle(self) -> None:
        """Each second: work on the image before while the next one is taken (Erlank 2013 §5.3.6)."""
        now_s, device_s = self._clock()
        if self._due_s is None or now_s < self._due_s:
            return
        start_s = device_s - (now_s - self._due_s)
        # After a pause of the simulation the cycle goes on with the next whole second; lost ones stay lost.
        self._due_s += CYCLE_S * max(1.0, np.ceil((now_s - self._due_s) / CYCLE_S))
        previous = self._last_slot
        if previous is not None:
            self._iterate(previous, 0)
        slot = CYCLE_SLOTS[0] if previous != CYCLE_SLOTS[0] else CYCLE_SLOTS[1]
        frame = self._tracker.capture(slot, min(self._tracker.exposure_ms, LONGEST_CYCLE_EXPOSURE_MS), start_s)
        self._outbox.telemetry(frame_report(frame), 0)
        self._last_slot = slot

    def start_cycle(self, _: Arguments, request_id: int) -> Returns:
        if self._due_s is None:
            self._due_s, self._last_slot = self._clock()[0], None
            self._outbox.event("CYCLE_STARTED", "", request_id)
        return {}

    def stop_cycle(self, _: Arguments, request_id: int) -> Returns:
        if self.restart():
            self._outbox.event("CYCLE_STOPPED", f"after iteration {self._tracker.iteration}", request_id)
        return {}

    def _iterate(self, slot: int, request_id: int) -> None:
        tracker = self._tracker
        mode, readable = tracker.mode, tracker.catalogue is not None
        had = tracker.solution is not None and tracker.solution.attitude is not None
        for report in tracker.process(slot):
            self._outbox.telemetry(report, request_id)
        if readable and tracker.catalogue is None:
            self._outbox.event("BANK_CORRUPT", tracker.catalogue_problem, request_id)
        self._tell_mode(mode, request_id)
        if had and not self._solved():
            self._outbox.event("ATTITUDE_LOST", f"frame {tracker.frame_number}", request_id)

    def _solved(self) -> bool:
        return self._tracker.solution is not None and self._tracker.solution.attitude is not None

    def _tell_mode(self, before: str, request_id: int) -> None:
        if self._tracker.mode != before:
            self._outbox.event("MODE_CHANGED", f"{before} to {self._tracker.mode}", request_id)

    def set_mode(self, a: Arguments, request_id: int) -> Returns:
        tracker, mode = self._tracker, str(a["mode"])
        if mode == "tracking" and tracker.quaternion is None:
            raise Refusal("wrong_state", "tracking needs an attitude: run an iteration first")
        if mode == "assisted" and tracker.hint is None and tracker.quaternion is None:
            raise Refusal("wrong_state", "assisted needs SET_ATTITUDE_HINT first")
        before, tracker.mode = tracker.mode, mode
        if mode == STANDBY:
            self.stop_cycle({}, request_id)
        self._tell_mode(before, request_id)
        return {}

    # --- images -------------------------------------------------------------------------------------------------

    def take_image(self, a: Arguments, request_id: int) -> Task:
        exposure_ms = int(a["exposure_ms"]) or self._tracker.exposure_ms
        taken = yield from self._expose(int(a["slot"]), exposure_ms, request_id)
        frame = self._tracker.stored(int(a["slot"]))
        if frame.truth is not None:
            self._outbox.telemetry(truth_report(frame.number, frame.truth), request_id)
        return taken

    def _expose(self, slot: int, exposure_ms: int, request_id: int) -> Task:
        tracker = self._tracker
        frame = tracker.capture(slot, exposure_ms, self._clock()[1])
        yield (tracker.timing.capture_ms + tracker.timing.transfer_ms) / 1000
        self._outbox.telemetry(frame_report(frame), request_id)
        return {"frame_number": frame.number, "slot": slot}

    def run_iteration(self, a: Arguments, request_id: int) -> Task:
        tracker, slot = self._tracker, int(a["slot"])
        taken = yield from self._expose(slot, tracker.exposure_ms, request_id)
        self._desk.progress(60)
        self._iterate(slot, request_id)
        t = tracker.timing
        yield (t.detect_ms + t.match_ms + t.attitude_ms) / 1000
        return {"frame_number": taken["frame_number"], "outcome": "solved" if self._solved() else "none"}

    def list_frames(self, _: Arguments, request_id: int) -> Returns:
        frames = sorted(self._tracker.slots.items())
        for _slot, frame in frames:
            self._outbox.telemetry(frame_report(frame), request_id)
        return {"count": len(frames)}

    # --- settings -----------------------------------------------------------------------------------------------

    def set_exposure(self, a: Arguments, _: int) -> Returns:
        self._tracker.exposure_ms = int(a["exposure_ms"])
        return {}

    def set_detection(self, a: Arguments, _: int) -> Returns:
        low, high = int(a["min_pixels"]), int(a["max_pixels"])
        if low > high:
            raise Refusal("out_of_range", f"smallest region {low} is above the largest {high}")
        tracker = self._tracker
        tracker.threshold_dn, tracker.min_pixels, tracker.max_pixels = int(a["threshold_dn"]), low, high
        return {}

    def set_attitude_hint(self, a: Arguments, _: int) -> Returns:
        names = ("ra_deg", "dec_deg", "roll_deg", "uncertainty_deg")
        ra_rad, dec_rad, roll_rad, radius_rad = (float(np.radians(float(a[n]))) for n in names)
        self._tracker.set_hint(ra_rad, dec_rad, roll_rad, radius_rad)
        return {}

    # --- stars --------------------------------------------------------------------------------------------------

    def find_centroids(self, a: Arguments, request_id: int) -> Task:
        tracker = self._tracker
        detection = tracker.find_centroids(int(a["slot"]))
        yield tracker.timing.detect_ms / 1000
        self._outbox.telemetry(tracker.centroid_report(), request_id)
        return {
            "frame_number": tracker.frame_number,
            "centroids": min(255, len(detection.centroids)),
            "regions_invalid": min(255, detection.invalid),
        }

    def match_stars(self, _: Arguments, request_id: int) -> Task:
        tracker = self._tracker
        if tracker.load_catalogue():
            self._outbox.event("BANK_CORRUPT", tracker.catalogue_problem, request_id)
        matching = tracker.match_stars()
        yield tracker.timing.match_ms / 1000
        self._outbox.telemetry(tracker.match_report(), request_id)
        if matching.reason:
            raise Refusal("too_few_stars" if len(matching.row) < 3 else "no_match", matching.reason)
        return {"frame_number": tracker.frame_number, "matched": tracker.matched}

    def calculate_attitude(self, _: Arguments, request_id: int) -> Task:
        tracker, mode = self._tracker, self._tracker.mode
        tracker.calculate_attitude()
        yield tracker.timing.attitude_ms / 1000
        self._outbox.telemetry(tracker.attitude_report(), request_id)
        self._tell_mode(mode, request_id)
        return {"frame_number": tracker.frame_number, "outcome": "solved" if self._solved() else "none"}
