"""Handlers of the commands for images, stars and attitude, and the 1 Hz cycle."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from gss.device.simulator.command_desk import Arguments, CommandDesk, Guard, Handler, Returns, Task
from gss.device.simulator.firmware import STANDBY, StarTracker
from gss.device.simulator.images import StoredFrame
from gss.device.simulator.outbox import Outbox
from gss.device.simulator.power import Power
from gss.device.simulator.refusal import Refusal
from gss.device.simulator.reports import frame_report, truth_report
from gss.pipeline.chains.modes import Mode

CYCLE_SLOTS = (2, 3)
LONGEST_CYCLE_EXPOSURE = 0.5
"""Maximum fraction of the period; the rest is for readout and processing (Erlank 2013 §5.3.6)."""
DEFAULT_PERIOD_MS = 1000
IMAGE_RAILS, PROCESS_RAILS = ("imager", "fpga", "sram"), ("sram",)


class TrackerOrders:
    """Handlers for a StarTracker. ``clock``: returns (now, simulated seconds of the sky)."""

    def __init__(
        self,
        tracker: StarTracker,
        outbox: Outbox,
        desk: CommandDesk,
        power: Power,
        clock: Callable[[], tuple[float, float]],
    ) -> None:
        self._tracker, self._outbox, self._desk, self._power, self._clock = tracker, outbox, desk, power, clock
        self.period_ms = DEFAULT_PERIOD_MS
        self._due_s: float | None = None
        self._last_slot: int | None = None

    def handlers(self) -> dict[str, Handler]:
        """Return the handlers by command name."""
        return {
            "SET_MODE": self.set_mode,
            "START_CYCLE": self.start_cycle,
            "STOP_CYCLE": self.stop_cycle,
            "RUN_ITERATION": self.run_iteration,
            "TAKE_IMAGE": self.take_image,
            "LIST_FRAMES": self.list_frames,
            "FIND_CENTROIDS": self.find_centroids,
            "MATCH_STARS": self.match_stars,
            "CALCULATE_ATTITUDE": self.calculate_attitude,
            "GET_CENTROIDS": self.get_centroids,
            "GET_MATCHES": self.get_matches,
            "GET_ATTITUDE": self.get_attitude,
        }

    def guards(self) -> dict[str, Guard]:
        """Return the power checks by command name; a command without power is rejected."""
        image = ("TAKE_IMAGE", "RUN_ITERATION", "START_CYCLE")
        return {name: lambda _: self._need(IMAGE_RAILS) for name in image} | {
            "FIND_CENTROIDS": lambda _: self._need(PROCESS_RAILS)
        }

    def _need(self, rails: tuple[str, ...]) -> None:
        off = [rail for rail in rails if not self._power.on(rail)]
        if off:
            raise Refusal("powered_off", f"{', '.join(off)} {'has' if len(off) == 1 else 'have'} no power")

    # --- cycle --------------------------------------------------------------------------------------------------

    @property
    def cycle_running(self) -> bool:
        """True if the cycle is running."""
        return self._due_s is not None

    def restart(self) -> bool:
        """Stop the cycle without an event; True if it was running."""
        ran = self.cycle_running
        self._due_s = self._last_slot = None
        return ran

    def reset(self) -> None:
        """Reset to power-on."""
        self.restart()
        self.period_ms = DEFAULT_PERIOD_MS

    def stop_without_power(self) -> None:
        """Stop the cycle if a rail it needs has no power."""
        off = [rail for rail in IMAGE_RAILS if not self._power.on(rail)]
        if off and self.restart():
            self._outbox.event("CYCLE_STOPPED", f"{off[0]} has no power")

    def run_cycle(self) -> None:
        """In each period, process the previous image while the next one is exposed (Erlank 2013 §5.3.6)."""
        now_s, sky_s = self._clock()
        if self._due_s is None or now_s < self._due_s:
            return
        start_s, period_s = sky_s - (now_s - self._due_s), self.period_ms / 1000
        # After a pause of the simulation the cycle continues with the next whole period; missed ones are skipped.
        self._due_s += period_s * max(1.0, np.ceil((now_s - self._due_s) / period_s))
        previous = self._last_slot
        if previous is not None:
            self._iterate(previous, 0)
            t = self._tracker.timing
            # Processing longer than the period delays the next iteration by whole periods (Sunsat lost in space: 14 s).
            late_s = (t.detect_ms + t.match_ms + t.attitude_ms) / 1000 - period_s
            self._due_s += period_s * max(0.0, np.ceil(late_s / period_s))
        slot = CYCLE_SLOTS[0] if previous != CYCLE_SLOTS[0] else CYCLE_SLOTS[1]
        longest_ms = round(LONGEST_CYCLE_EXPOSURE * self.period_ms)
        frame = self._tracker.capture(slot, min(self._tracker.exposure_ms, longest_ms), start_s)
        self._tell_frame(frame, 0)
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
        had = tracker.solved
        for report in tracker.process(slot):
            self._outbox.telemetry(report, request_id)
        if readable and tracker.catalogue is None:
            self._outbox.event("BANK_CORRUPT", tracker.catalogue_problem, request_id)
        self._tell_mode(mode, request_id)
        if had and not tracker.solved:
            self._outbox.event("ATTITUDE_LOST", f"frame {tracker.frame_number}", request_id)

    def _tell_mode(self, before: str, request_id: int) -> None:
        if self._tracker.mode != before:
            self._outbox.event("MODE_CHANGED", f"{before} to {self._tracker.mode}", request_id)

    def set_mode(self, a: Arguments, request_id: int) -> Returns:
        tracker, mode = self._tracker, str(a["mode"])
        known = tracker.known
        if mode == "tracking" and known.quaternion is None:
            raise Refusal("wrong_state", "tracking needs an attitude: run an iteration first")
        if mode == "assisted" and known.usable(Mode.ASSISTED) is not Mode.ASSISTED:
            raise Refusal("wrong_state", "assisted needs SET_ATTITUDE_HINT, or SET_ORBIT and SET_APRIORI, first")
        before, tracker.mode = tracker.mode, mode
        if mode == STANDBY:
            self.stop_cycle({}, request_id)
        self._tell_mode(before, request_id)
        return {}

    # --- images -------------------------------------------------------------------------------------------------

    def take_image(self, a: Arguments, request_id: int) -> Task:
        exposure_ms = int(a["exposure_ms"]) or self._tracker.exposure_ms
        taken = yield from self._expose(int(a["slot"]), exposure_ms, request_id)
        frame = self._tracker.imager.stored(int(a["slot"]))
        if frame.truth is not None:
            self._outbox.telemetry(truth_report(frame.number, frame.truth), request_id)
        return taken

    def _expose(self, slot: int, exposure_ms: int, request_id: int) -> Task:
        tracker = self._tracker
        frame = tracker.capture(slot, exposure_ms, self._clock()[1])
        yield (tracker.timing.capture_ms + tracker.timing.transfer_ms) / 1000
        if self._tracker.slots.get(slot) is not frame:
            raise Refusal("powered_off", "the image memory lost its power")
        self._tell_frame(frame, request_id)
        return {"frame_number": frame.number, "slot": slot}

    def _tell_frame(self, frame: StoredFrame, request_id: int) -> None:
        self._outbox.telemetry(frame_report(frame), request_id)
        if self._tracker.imager.repeated:
            self._outbox.event("IMAGE_REPEATED", f"frame {frame.number} is the one before", request_id)

    def run_iteration(self, a: Arguments, request_id: int) -> Task:
        tracker, slot = self._tracker, int(a["slot"])
        taken = yield from self._expose(slot, tracker.exposure_ms, request_id)
        self._desk.progress(60)
        self._iterate(slot, request_id)
        t = tracker.timing
        yield (t.detect_ms + t.match_ms + t.attitude_ms) / 1000
        return {"frame_number": taken["frame_number"], "outcome": "solved" if self._tracker.solved else "none"}

    def list_frames(self, _: Arguments, request_id: int) -> Returns:
        frames = sorted(self._tracker.slots.items())
        for _slot, frame in frames:
            self._outbox.telemetry(frame_report(frame), request_id)
        return {"count": len(frames)}

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
        for report in (tracker.attitude_report(), *tracker.vector_reports()):
            self._outbox.telemetry(report, request_id)
        self._tell_mode(mode, request_id)
        return {"frame_number": tracker.frame_number, "outcome": "solved" if self._tracker.solved else "none"}

    # --- stored results -----------------------------------------------------------------------------------------

    def get_centroids(self, _: Arguments, request_id: int) -> Returns:
        tracker = self._tracker
        if tracker.detection is None:
            raise Refusal("no_image", "no centroids: FIND_CENTROIDS comes first")
        self._outbox.telemetry(tracker.centroid_report(), request_id)
        return {"frame_number": tracker.frame_number, "count": min(255, len(tracker.detection.centroids))}

    def get_matches(self, _: Arguments, request_id: int) -> Returns:
        tracker = self._tracker
        if tracker.matching is None:
            raise Refusal("no_image", "no matches: MATCH_STARS comes first")
        self._outbox.telemetry(tracker.match_report(), request_id)
        return {"frame_number": tracker.frame_number, "count": tracker.matched}

    def get_attitude(self, _: Arguments, request_id: int) -> Returns:
        tracker = self._tracker
        if tracker.solution is None:
            raise Refusal("no_image", "no attitude: CALCULATE_ATTITUDE comes first")
        for report in (tracker.attitude_report(), *tracker.vector_reports()):
            self._outbox.telemetry(report, request_id)
        return {"frame_number": tracker.frame_number, "outcome": "solved" if tracker.solved else "none"}
