"""Star tracker processing: detection, matching and attitude, with the instrument's chain and the content of the active
banks.

Independent of the link. The active tables determine chain, camera and constants. The chain computes the durations from
the figures in its document, scaled by the amount of work.
"""

from __future__ import annotations

from collections.abc import Callable, Generator
from dataclasses import replace
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from gss.catalogue_tools.onboard import decode
from gss.device.simulator import reports
from gss.device.simulator.clock import DeviceClock
from gss.device.simulator.imager import Imager
from gss.device.simulator.images import StoredFrame
from gss.device.simulator.memory import Memory
from gss.device.simulator.rejection import Rejection
from gss.device.simulator.reports import Report, Timing
from gss.device.simulator.sky import SimulatedSky
from gss.device.simulator.tables_on_board import Tables
from gss.device.simulator.vectors import no_vectors, vector_report
from gss.device.table_use import parameters_with
from gss.domain.camera_profile import CameraProfile
from gss.domain.errors import BadInput, CorruptData
from gss.domain.frames import cam_from_icrs
from gss.domain.rotation import quaternion_from_matrix
from gss.instruments.dictionary.definitions import Value
from gss.instruments.package_files import TYPICAL, UnitTiming
from gss.pipeline.chains.apriori import PriorState
from gss.pipeline.chains.modes import Mode
from gss.pipeline.chains.onboard import Commanded, Detection, OnboardChain, OnboardSolution, Work
from gss.pipeline.fixed_pattern import without_bad_pixels
from gss.skytables.bank import OnboardCatalogue

STANDBY = "standby"
NEED_STARS = ("oersted",)
"""Chains whose detection needs the magnitude limit of the prepared catalogue."""
STALE = "the attitude is not updated"

T = TypeVar("T")
Stage = Generator[float, None, T]
"""A task that yields durations in seconds of simulated time and returns its result."""

__all__ = ["STANDBY", "Rejection", "StarTracker"]


class StarTracker:
    """Settings and results of the star tracker. A method raises Rejection if it cannot be executed. ``clock``: device
    clock, which provides the time stamps of frames."""

    def __init__(self, profile: CameraProfile, sky: SimulatedSky, memory: Memory, timing: UnitTiming = TYPICAL) -> None:
        self.profile, self.sky, self._memory = profile, sky, memory
        self.imager = Imager(profile, sky, memory, timing)
        self.tables = Tables(profile, memory)
        self.clock = DeviceClock(memory, memory.record.time_base_s)
        self.stale = False
        self.restart()

    def restart(self) -> None:
        """Reset to the power-on state: settings from profile and tables, no known attitude, catalogue from the active
        bank."""
        self.imager.restart()
        self.mode = "lost_in_space"
        self.exposure_ms = round(self.profile.sensor.exposure_s * 1000)
        self.prior = PriorState()
        self.frame: StoredFrame | None = None
        self.detection: Detection | None = None
        self.matching: Any = None
        self.solution: OnboardSolution | None = None
        self.work: Work | None = None
        self.sigma_rad = (float("nan"), float("nan"))
        self.attitude_time_s: float | None = None
        self.iteration = 0
        self.timing = Timing()
        self._prepared: tuple[tuple[object, ...], Any] | None = None
        self.load_tables()
        self.load_catalogue()

    # --- flash content ------------------------------------------------------------------------------------------

    def load_tables(self) -> list[str]:
        """Read the active tables and set the detection constants from their values. Returns the problems."""
        problems = self.tables.load()
        parameters = self._parameters(self.exposure_ms, Commanded(), Mode.LOST_IN_SPACE)
        # FAR-MST derives its threshold from each frame's noise; 0 selects this until a threshold is commanded.
        self.threshold_dn = round(getattr(parameters, "threshold_dn", None) or 0)
        self.min_pixels, self.max_pixels = int(parameters.min_area_px), int(parameters.max_area_px)
        return problems

    @property
    def chain(self) -> OnboardChain:
        """The chain to which the active parameters belong."""
        return self.tables.chain

    def load_catalogue(self) -> str:
        """Read the active bank. Returns the reason if the bank cannot be used, "" otherwise."""
        memory, bank = self._memory, self._memory.record.active
        self.catalogue: OnboardCatalogue | None = None
        self.catalogue_problem = ""
        if memory.record.banks[bank].state not in ("committed", "corrupt"):
            self.catalogue_problem = f"bank {bank} is {memory.record.banks[bank].state}"
        else:
            try:
                self.catalogue = decode(memory.content(bank))
            except (CorruptData, BadInput) as error:
                self.catalogue_problem = f"bank {bank}: {error}"
        return self.catalogue_problem

    def unsuitable(self, bank: str) -> str:
        """Return the reason if the chain cannot use a readable bank, e.g. a bank without magnitudes; "" if it can."""
        try:
            catalogue = decode(self._memory.content(bank))
        except (CorruptData, BadInput):
            return ""  # a damaged bank is reported when it is read
        try:
            # The active triplet table belongs to the previous bank, so it is not used here; a mismatch is reported at
            # the first image.
            self.chain.prepare(catalogue, self.profile)
        except (BadInput, CorruptData) as error:
            return str(error)
        return ""

    def _current_catalogue(self) -> Any:
        """Return the chain's prepared catalogue, prepared again if bank or tables have changed. Raises Rejection."""
        if self.catalogue is None:
            raise Rejection("bank_corrupt", self.catalogue_problem)
        record = self._memory.record
        key = (record.active, record.banks[record.active].sha256, self.tables.key)
        if self._prepared is None or self._prepared[0] != key:
            try:
                self._prepared = key, self.tables.prepare(self.catalogue)
            except (BadInput, CorruptData) as error:
                raise Rejection("incompatible", str(error)) from error
        return self._prepared[1]

    # --- settings -----------------------------------------------------------------------------------------------

    def _commanded(self, mode: Mode) -> Commanded:
        """Return the operator's settings for a mode."""
        radius_rad = self.prior.radius_rad(mode)
        threshold_dn = float(self.threshold_dn) if self.threshold_dn else None
        return Commanded(threshold_dn, self.min_pixels, max(self.max_pixels, self.min_pixels), radius_rad)

    def _parameters(self, exposure_ms: int, commanded: Commanded, mode: Mode) -> Any:
        exposure_s = max(exposure_ms, 1) / 1000
        return parameters_with(self.tables.parameters, self.tables.profile, exposure_s, commanded, mode)

    def set_hint(self, ra_rad: float, dec_rad: float, roll_rad: float, radius_rad: float) -> None:
        """Set the commanded attitude and its radius (SET_ATTITUDE_HINT)."""
        quaternion = quaternion_from_matrix(cam_from_icrs(ra_rad, dec_rad, roll_rad))
        self.prior = replace(self.prior, commanded=quaternion, commanded_radius_rad=radius_rad)

    @property
    def quaternion(self) -> NDArray[np.float64] | None:
        """Quaternion of the last attitude, or None."""
        return self.prior.quaternion

    # --- imaging ------------------------------------------------------------------------------------------------

    @property
    def slots(self) -> dict[int, StoredFrame]:
        """The image memories."""
        return self.imager.slots

    def capture(self, slot: int, exposure_ms: int, start_s: float) -> StoredFrame:
        """Expose into an image memory; ``start_s``: simulated time of the command."""
        mid_s = self.imager.middle_s(start_s, exposure_ms)
        frame = self.imager.capture(slot, exposure_ms, mid_s, self.clock.at(mid_s), self.mode)
        self.timing.capture_ms, self.timing.transfer_ms = self.imager.capture_ms(exposure_ms), self.imager.transfer_ms
        return frame

    # --- the chain ----------------------------------------------------------------------------------------------

    def warm(self) -> None:
        """Process an empty frame and discard the result, to load the chain's data.

        Without this, loading takes a second or more at the chain's first use and delays a command.
        """
        camera = self.profile.camera
        parameters = self._parameters(self.exposure_ms, Commanded(), Mode.LOST_IN_SPACE)
        work = Work(self.tables.profile.camera, self._current_catalogue(), parameters, Mode.LOST_IN_SPACE, None)
        self.chain.find_centroids(np.zeros((camera.rows, camera.columns), np.uint16), work)

    def _work(self, frame: StoredFrame, catalogue: Any) -> Work:
        """Return the input of the chain for a frame, with the current a-priori attitude and settings."""
        requested_mode = Mode.LOST_IN_SPACE if self.mode == STANDBY else Mode(self.mode)
        mode = self.prior.usable(requested_mode, frame.time_s, self.chain.oldest_attitude_s)
        parameters = self._parameters(frame.exposure_ms, self._commanded(mode), mode)
        hint = self.prior.hint(mode, frame.time_s)
        return Work(self.tables.profile.camera, catalogue, parameters, mode, hint, frame.dark)

    def detect(self, frame: StoredFrame) -> tuple[Work, Detection]:
        """Detect centroids without storing them."""
        try:
            catalogue = self._current_catalogue()
        except Rejection:
            catalogue = None
        work = self._work(frame, catalogue)
        if catalogue is None and work.mode is Mode.TRACKING:
            # Search windows are predicted with the catalogue. If there is no catalogue, the whole frame is searched.
            work = replace(work, mode=Mode.LOST_IN_SPACE, hint=None)
        if catalogue is None and self.chain.name in NEED_STARS:
            raise Rejection("bank_corrupt", self.catalogue_problem)
        return work, self.chain.find_centroids(without_bad_pixels(frame.pixels, self.tables.bad_pixels), work)

    # Each stage is a task: it yields its duration, and its results become visible afterwards. A command can change the
    # stored results between two stages, so each stage receives the results of the previous stage as arguments.

    def find_centroids(self, frame: StoredFrame) -> Stage[tuple[Work, Detection]]:
        """Detect centroids (FIND_CENTROIDS); discards the previous matches."""
        work, detection = self.detect(frame)
        spent_ms = self.chain.detect_ms(frame.pixels.size, detection)
        yield spent_ms / 1000
        self.keep(frame, work, detection)
        self.timing.detect_ms = spent_ms
        return work, detection

    def keep(self, frame: StoredFrame, work: Work, detection: Detection) -> None:
        """Store centroids as the latest result."""
        self.frame, self.work, self.detection = frame, work, detection
        self.matching = self.solution = None

    def match_stars(self, frame: StoredFrame, detection: Detection) -> Stage[tuple[Work, Any]]:
        """Match centroids (MATCH_STARS). Reads the bank again, to use the current flash content."""
        self.load_catalogue()
        work = self._work(frame, self._current_catalogue())
        matching = self.chain.match_stars(detection.centroids, work)
        spent_ms = self.chain.match_ms(matching)
        yield spent_ms / 1000
        self.frame, self.work, self.detection = frame, work, detection
        self.matching, self.solution = matching, None
        self.timing.match_ms = spent_ms
        return work, matching

    def calculate_attitude(
        self, frame: StoredFrame, work: Work, detection: Detection, matching: Any
    ) -> Stage[OnboardSolution]:
        """Calculate the attitude from matches (CALCULATE_ATTITUDE) and set the mode of the next iteration."""
        spent_ms = self.chain.attitude_ms(matching)
        yield spent_ms / 1000
        solution = self.chain.calculate_attitude(matching, detection.centroids, work)
        if self.stale and solution.attitude is not None:
            solution = OnboardSolution(None, None, solution.false_match_probability, STALE)
        self.frame, self.work, self.detection, self.matching = frame, work, detection, matching
        self.solution = solution
        self.timing.attitude_ms = spent_ms
        quaternion = None if solution.attitude is None else np.asarray(solution.attitude.quaternion, float)
        self.prior = self.prior.after(quaternion, frame.time_s)
        if solution.attitude is not None:
            self.sigma_rad = solution.attitude.sigma_rad
            self.attitude_time_s = frame.time_s
        if self.mode != STANDBY:
            self.mode = self.chain.next_mode(Mode(self.mode), quaternion is not None).value
        return solution

    def process(self, slot: int, send: Callable[[Report], None]) -> Stage[None]:
        """Process the image in a slot: one iteration. Each stage's telemetry is passed to ``send`` when the stage is
        finished."""
        self.iteration += 1
        frame = self.imager.stored(slot)
        self.load_catalogue()
        problem = ""
        try:
            work, detection = yield from self.find_centroids(frame)
            self.timing.match_ms = self.timing.attitude_ms = 0.0
            send(self.centroid_report())
            work, matching = yield from self.match_stars(frame, detection)
            yield from self.calculate_attitude(frame, work, detection, matching)
            send(self.match_report())
        except Rejection as rejection:
            # Without a catalogue no attitude is possible, which ends the series of attitudes like an unsolved frame.
            if self.frame is not frame:  # the detection failed, and its last results belong to another frame
                self.work = self.detection = None
                self.timing.detect_ms = self.timing.match_ms = self.timing.attitude_ms = 0.0
            problem, self.frame = rejection.detail, frame
            self.matching = self.solution = None
            self.prior = self.prior.after(None, frame.time_s)
        for report in (self.attitude_report(problem), *self.vector_reports(), self.timing_report()):
            send(report)
        if frame.truth is not None:
            send(reports.truth_report(frame.number, frame.truth))

    # --- reports ------------------------------------------------------------------------------------------------

    @property
    def solved(self) -> bool:
        """True if the latest calculation gave an attitude."""
        return self.solution is not None and self.solution.attitude is not None

    @property
    def frame_number(self) -> int:
        """Frame number of the latest results."""
        return self.frame.number if self.frame else 0

    def centroid_report(self) -> Report:
        """Return the packet "centroids"."""
        assert self.detection is not None  # noqa: S101 - callers have just detected
        return reports.centroid_report(self.frame_number, self.detection)

    def match_report(self) -> Report:
        """Return the packet "matches"."""
        assert self.matching is not None  # noqa: S101 - callers have just matched
        return reports.match_report(self.frame_number, self.matching)

    def vector_reports(self) -> list[Report]:
        """Return the packet "matched_vectors", without vectors if there is no attitude. Returns no packet before orbit
        and time are set."""
        orbit, offset_s = self.prior.orbit, self._memory.record.utc_offset_s
        if orbit is None or offset_s is None or not self.frame:
            return []
        if not self.solved or not self.work or not self.detection or not self.solution:
            return [no_vectors(self.frame)]
        utc_s, row = self.frame.time_s + offset_s, self.matching.row
        return [vector_report(self.frame, self.work, self.detection, self.solution, row, orbit, utc_s)]

    def late_reports(self, slot: int) -> list[Report]:
        """Return the packets for an iteration that did not finish in its period. They contain no vectors (Jacobs 1995
        §4.3)."""
        has_place = self.prior.orbit is not None and self._memory.record.utc_offset_s is not None
        return [no_vectors(self.imager.stored(slot))] if has_place else []

    def attitude_report(self, problem: str = "") -> Report:
        """Return the packet "attitude"; ``problem``: reason if there is no attitude."""
        solution = self.solution
        values: dict[str, Value] = {
            "frame_number": self.frame_number,
            "frame_time_s": self.frame.time_s if self.frame else 0.0,
            "mode": (self.work.mode if self.work else Mode.LOST_IN_SPACE).value,
            "centroids": min(255, len(self.detection.centroids)) if self.detection else 0,
            "matched": self.matched,
            "match_confidence": 100.0 * self.matching.confidence if self.matching is not None else 0.0,
        }
        reason = problem or (solution.reason if solution else "")
        return reports.attitude_report(values, solution.attitude if solution else None, reason)

    @property
    def matched(self) -> int:
        """Number of stars in the latest identification."""
        return min(255, len(self.matching.selected)) if self.matching is not None else 0

    def timing_report(self) -> Report:
        """Return the packet "timing"."""
        return reports.timing_report(self.iteration, self.frame_number, self.timing)
