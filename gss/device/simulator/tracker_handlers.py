"""Handlers of the commands for images, stars and attitude, and the 1 Hz cycle."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from gss.device.simulator.command_processor import Arguments, CommandProcessor, Guard, Handler, Returns, Task
from gss.device.simulator.firmware import STANDBY, StarTracker
from gss.device.simulator.images import StoredFrame
from gss.device.simulator.outbox import Outbox
from gss.device.simulator.power import Activity, Power
from gss.device.simulator.rejection import Rejection
from gss.device.simulator.reports import frame_report, truth_report
from gss.pipeline.chains.modes import Mode

CYCLE_SLOTS = (2, 3)
IMAGE_RAILS, PROCESS_RAILS = ("imager", "fpga", "sram"), ("sram",)


@dataclass(eq=False)
class _CycleTask:
    """A task of the cycle. ``due_s``: simulated time at which it continues."""

    task: Task
    due_s: float


class TrackerHandlers:
    """Handlers for a StarTracker. ``clock``: returns the current time and the simulated time of the sky. ``cycle_ms``:
    period at power-on."""

    def __init__(
        self,
        tracker: StarTracker,
        outbox: Outbox,
        processor: CommandProcessor,
        power: Power,
        clock: Callable[[], tuple[float, float]],
        cycle_ms: int,
    ) -> None:
        self._tracker, self._outbox, self._processor, self._power, self._clock = (
            tracker,
            outbox,
            processor,
            power,
            clock,
        )
        self._cycle_ms = self.period_ms = cycle_ms
        self._due_s: float | None = None
        self._last_slot: int | None = None
        self._activities: list[_CycleTask] = []
        self._stage = Activity.IDLE

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
        """Return the power checks by command name. A command is rejected if a rail that it needs has no power."""
        image = ("TAKE_IMAGE", "RUN_ITERATION", "START_CYCLE")
        return {name: lambda _: self._check_power(IMAGE_RAILS) for name in image} | {
            "FIND_CENTROIDS": lambda _: self._check_power(PROCESS_RAILS)
        }

    def _check_power(self, rails: tuple[str, ...]) -> None:
        off = [rail for rail in rails if not self._power.on(rail)]
        if off:
            raise Rejection("powered_off", f"{', '.join(off)} {'has' if len(off) == 1 else 'have'} no power")

    # --- cycle --------------------------------------------------------------------------------------------------

    @property
    def cycle_running(self) -> bool:
        """True if the cycle is running."""
        return self._due_s is not None

    @property
    def activity(self) -> Activity:
        """Current activity of the cycle."""
        return self._stage if self.cycle_running else Activity.IDLE

    def restart(self) -> bool:
        """Stop the cycle without an event. Returns True if it was running."""
        ran = self.cycle_running
        self._due_s = self._last_slot = None
        self._activities, self._stage = [], Activity.IDLE
        return ran

    def reset(self) -> None:
        """Reset to the power-on state."""
        self.restart()
        self.period_ms = self._cycle_ms

    def stop_without_power(self) -> None:
        """Stop the cycle if a rail that it needs has no power."""
        off = [rail for rail in IMAGE_RAILS if not self._power.on(rail)]
        if off and self.restart():
            self._outbox.event("CYCLE_STOPPED", f"{off[0]} has no power")

    def run_cycle(self) -> None:
        """In each period, process the previous image while the next one is exposed (Erlank 2013 §5.3.6)."""
        now_s, sky_s = self._clock()
        while self._due_s is not None and self._activities:
            first = min(self._activities, key=lambda a: a.due_s)
            if now_s < first.due_s:
                break
            try:
                first.due_s += next(first.task)
            except StopIteration:
                if first in self._activities:  # STOP_CYCLE or a power failure can have ended this activity
                    self._activities.remove(first)
        if self._due_s is None or now_s < self._due_s:
            return
        start_s, period_s = self._due_s, self.period_ms / 1000
        # After a pause of the simulation the cycle continues with the next whole period; missed periods are skipped.
        self._due_s += period_s * max(1.0, np.ceil((now_s - self._due_s) / period_s))
        if self._activities:
            # Processing longer than the period delays the next iteration by whole periods (Sunsat lost in space: 14 s).
            if self._last_slot is not None:
                for report in self._tracker.late_reports(self._last_slot):
                    self._outbox.telemetry(report, 0)
            return
        previous = self._last_slot
        slot = CYCLE_SLOTS[0] if previous != CYCLE_SLOTS[0] else CYCLE_SLOTS[1]
        processing = None if previous is None else _CycleTask(self._process_last(previous), start_s)
        exposing = _CycleTask(self._expose_next(slot, start_s, start_s - (now_s - sky_s), processing), start_s)
        self._activities = [a for a in (processing, exposing) if a is not None]

    def _expose_next(self, slot: int, start_s: float, sky_start_s: float, processing: _CycleTask | None) -> Task:
        """Expose the next image during processing, then copy it. The copy waits for the processing, because it needs
        the processor too. If processing took longer than the period, the image is too old and a new image is exposed at
        the next whole period."""
        tracker, period_s = self._tracker, self.period_ms / 1000
        exposure_ms = min(tracker.exposure_ms, tracker.imager.longest_ms(self.period_ms))
        frame = tracker.capture(slot, exposure_ms, sky_start_s)
        passed_s, started_s = tracker.imager.occupied_ms(exposure_ms) / 1000, tracker.imager.start_ms / 1000
        self._stage = Activity.STARTING if started_s else Activity.BUSY
        yield started_s
        self._stage = Activity.BUSY
        yield passed_s - started_s
        if processing is not None:
            while processing in self._activities:
                waited_s = max(0.0, processing.due_s - start_s - passed_s)
                passed_s += waited_s
                yield waited_s
            if passed_s > period_s:
                late_s = period_s * np.ceil(passed_s / period_s)
                yield late_s - passed_s
                frame = tracker.capture(slot, exposure_ms, sky_start_s + late_s)
                yield tracker.imager.occupied_ms(exposure_ms) / 1000
        self._stage = Activity.COPYING if tracker.imager.transfer_ms else Activity.IDLE
        yield tracker.imager.transfer_ms / 1000
        self._stage = Activity.IDLE
        self._last_slot = slot
        if not tracker.imager.overlapped_ms:
            self._report_frame(frame, 0)
        return {}

    def _process_last(self, slot: int) -> Task:
        """Process the image of the last period. A sensor with overlapped readout first completes the readout of this
        image."""
        tracker = self._tracker
        frame, readout_ms = tracker.imager.stored(slot), tracker.imager.overlapped_ms
        if readout_ms:
            yield readout_ms / 1000
            self._report_frame(frame, 0)
        yield from self._iterate(slot, 0)
        return {}

    def start_cycle(self, _: Arguments, request_id: int) -> Returns:
        if self._due_s is None:
            self._due_s, self._last_slot = self._clock()[0], None
            self._outbox.event("CYCLE_STARTED", "", request_id)
        return {}

    def stop_cycle(self, _: Arguments, request_id: int) -> Returns:
        if self.restart():
            self._outbox.event("CYCLE_STOPPED", f"after iteration {self._tracker.iteration}", request_id)
        return {}

    def _iterate(self, slot: int, request_id: int) -> Task:
        tracker = self._tracker
        mode, readable = tracker.mode, tracker.catalogue is not None
        had = tracker.solved
        yield from tracker.process(slot, lambda report: self._outbox.telemetry(report, request_id))
        if readable and tracker.catalogue is None:
            self._outbox.event("BANK_CORRUPT", tracker.catalogue_problem, request_id)
        self._report_mode(mode, request_id)
        if had and not tracker.solved:
            self._outbox.event("ATTITUDE_LOST", f"frame {tracker.frame_number}", request_id)
        return {}

    def _report_mode(self, before: str, request_id: int) -> None:
        if self._tracker.mode != before:
            self._outbox.event("MODE_CHANGED", f"{before} to {self._tracker.mode}", request_id)

    def set_mode(self, arguments: Arguments, request_id: int) -> Returns:
        tracker, mode = self._tracker, str(arguments["mode"])
        prior = tracker.prior
        if mode == "tracking" and prior.quaternion is None:
            raise Rejection("wrong_state", "the mode tracking needs an attitude: run an iteration first")
        if mode == "assisted" and prior.usable(Mode.ASSISTED) is not Mode.ASSISTED:
            raise Rejection(
                "wrong_state", "the mode assisted needs SET_ATTITUDE_HINT, or SET_ORBIT and SET_APRIORI, first"
            )
        before, tracker.mode = tracker.mode, mode
        if mode == STANDBY:
            self.stop_cycle({}, request_id)
        self._report_mode(before, request_id)
        return {}

    # --- images -------------------------------------------------------------------------------------------------

    def take_image(self, arguments: Arguments, request_id: int) -> Task:
        exposure_ms = int(arguments["exposure_ms"]) or self._tracker.exposure_ms
        exposure = yield from self._expose(int(arguments["slot"]), exposure_ms, request_id)
        frame = self._tracker.imager.stored(int(arguments["slot"]))
        if frame.truth is not None:
            self._outbox.telemetry(truth_report(frame.number, frame.truth), request_id)
        return exposure

    def _expose(self, slot: int, exposure_ms: int, request_id: int) -> Task:
        tracker = self._tracker
        frame = tracker.capture(slot, exposure_ms, self._clock()[1])
        yield (tracker.timing.capture_ms + tracker.timing.transfer_ms) / 1000
        if self._tracker.slots.get(slot) is not frame:
            raise Rejection("powered_off", "the image memory lost power")
        self._report_frame(frame, request_id)
        return {"frame_number": frame.number, "slot": slot}

    def _report_frame(self, frame: StoredFrame, request_id: int) -> None:
        self._outbox.telemetry(frame_report(frame), request_id)
        if self._tracker.imager.repeated:
            self._outbox.event("IMAGE_REPEATED", f"frame {frame.number} repeats the previous image", request_id)

    def run_iteration(self, arguments: Arguments, request_id: int) -> Task:
        tracker, slot = self._tracker, int(arguments["slot"])
        exposure = yield from self._expose(slot, tracker.exposure_ms, request_id)
        self._processor.progress(60)
        yield from self._iterate(slot, request_id)
        return {"frame_number": exposure["frame_number"], "outcome": "solved" if self._tracker.solved else "none"}

    def list_frames(self, _: Arguments, request_id: int) -> Returns:
        frames = sorted(self._tracker.slots.items())
        for _slot, frame in frames:
            self._outbox.telemetry(frame_report(frame), request_id)
        return {"count": len(frames)}

    # --- stars --------------------------------------------------------------------------------------------------

    def find_centroids(self, arguments: Arguments, request_id: int) -> Task:
        tracker = self._tracker
        _work, detection = yield from tracker.find_centroids(tracker.imager.stored(int(arguments["slot"])))
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
        if tracker.detection is None or tracker.frame is None:
            raise Rejection("no_image", "no centroids: run FIND_CENTROIDS first")
        _work, matching = yield from tracker.match_stars(tracker.frame, tracker.detection)
        self._outbox.telemetry(tracker.match_report(), request_id)
        if matching.reason:
            raise Rejection("too_few_stars" if len(matching.row) < 3 else "no_match", matching.reason)
        return {"frame_number": tracker.frame_number, "matched": tracker.matched}

    def calculate_attitude(self, _: Arguments, request_id: int) -> Task:
        tracker, mode = self._tracker, self._tracker.mode
        frame, work, detection = tracker.frame, tracker.work, tracker.detection
        if tracker.matching is None or detection is None or frame is None or work is None:
            raise Rejection("no_image", "no matches: run MATCH_STARS first")
        yield from tracker.calculate_attitude(frame, work, detection, tracker.matching)
        for report in (tracker.attitude_report(), *tracker.vector_reports()):
            self._outbox.telemetry(report, request_id)
        self._report_mode(mode, request_id)
        return {"frame_number": tracker.frame_number, "outcome": "solved" if self._tracker.solved else "none"}

    # --- stored results -----------------------------------------------------------------------------------------

    def get_centroids(self, _: Arguments, request_id: int) -> Returns:
        tracker = self._tracker
        if tracker.detection is None:
            raise Rejection("no_image", "no centroids: run FIND_CENTROIDS first")
        self._outbox.telemetry(tracker.centroid_report(), request_id)
        return {"frame_number": tracker.frame_number, "count": min(255, len(tracker.detection.centroids))}

    def get_matches(self, _: Arguments, request_id: int) -> Returns:
        tracker = self._tracker
        if tracker.matching is None:
            raise Rejection("no_image", "no matches: run MATCH_STARS first")
        self._outbox.telemetry(tracker.match_report(), request_id)
        return {"frame_number": tracker.frame_number, "count": tracker.matched}

    def get_attitude(self, _: Arguments, request_id: int) -> Returns:
        tracker = self._tracker
        if tracker.solution is None:
            raise Rejection("no_image", "no attitude: run CALCULATE_ATTITUDE first")
        for report in (tracker.attitude_report(), *tracker.vector_reports()):
            self._outbox.telemetry(report, request_id)
        return {"frame_number": tracker.frame_number, "outcome": "solved" if tracker.solved else "none"}
