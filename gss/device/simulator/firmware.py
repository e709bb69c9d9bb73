"""Star tracker processing: detection, matching and attitude, with its system's chain and the content of the active banks.

Independent of the link. The active tables determine chain, camera and constants. Durations come from the chain: its
document's figures, scaled by the work done.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gss.catalogue_tools.onboard import decode
from gss.device.dictionary import Value
from gss.device.simulator import reports
from gss.device.simulator.imager import Imager
from gss.device.simulator.images import StoredFrame
from gss.device.simulator.memory import Memory
from gss.device.simulator.refusal import Refusal
from gss.device.simulator.reports import Report, Timing
from gss.device.simulator.sky import Sky
from gss.device.simulator.tables_on_board import Tables
from gss.device.simulator.vectors import vector_report
from gss.device.table_use import parameters_with
from gss.domain.errors import BadInput, CorruptData
from gss.domain.frames import cam_from_icrs
from gss.domain.profiles import CameraProfile
from gss.domain.rotation import quaternion_from_matrix
from gss.domain.stars import OnboardCatalogue
from gss.pipeline.chains.apriori import Known
from gss.pipeline.chains.modes import Mode
from gss.pipeline.chains.onboard import Commanded, Detection, OnboardChain, Solution, Work

STANDBY = "standby"
NEED_STARS = ("oersted",)
"""Chains whose detection needs the magnitude limit of the prepared catalogue."""
STALE = "the attitude is not renewed"

__all__ = ["STANDBY", "Refusal", "StarTracker"]


class StarTracker:
    """Settings and results. Methods raise Refusal if they cannot do their work.

    ``device_time``: converts simulated time to the device's clock; set by the owner.
    """

    def __init__(self, profile: CameraProfile, sky: Sky, memory: Memory) -> None:
        self.profile, self.sky, self._memory = profile, sky, memory
        self.imager = Imager(profile, sky, memory)
        self.tables = Tables(profile, memory)
        self.device_time: Callable[[float], float] = lambda simulated_s: simulated_s
        self.stale = False
        self.restart()

    def restart(self) -> None:
        """Reset to power-on: settings from profile and tables, no attitude knowledge, catalogue from the active bank."""
        self.imager.restart()
        self.mode, self.used_mode = "lost_in_space", "lost_in_space"
        self.exposure_ms = round(self.profile.sensor.exposure_s * 1000)
        self.known = Known()
        self.frame: StoredFrame | None = None
        self.detection: Detection | None = None
        self.matching: Any = None
        self.solution: Solution | None = None
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
        """Read the active tables and set the detection constants from them. Returns the problems."""
        problems = self.tables.load()
        parameters = self._parameters(self.exposure_ms, Commanded(), Mode.LOST_IN_SPACE)
        # FAR-MST derives its threshold from each frame's noise; 0 means that until one is commanded.
        self.threshold_dn = round(getattr(parameters, "threshold_dn", None) or 0)
        self.min_pixels, self.max_pixels = int(parameters.min_area_px), int(parameters.max_area_px)
        return problems

    @property
    def chain(self) -> OnboardChain:
        """The chain that the active parameters are for."""
        return self.tables.chain

    def load_catalogue(self) -> str:
        """Read the active bank. Returns the reason if it cannot be used, "" otherwise."""
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
        """Return why the chain cannot match from a readable bank, e.g. without magnitudes; "" if it can."""
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

    def _catalogue_at_work(self) -> Any:
        """Return the chain's prepared catalogue, prepared again if bank or tables have changed. Raises Refusal."""
        if self.catalogue is None:
            raise Refusal("bank_corrupt", self.catalogue_problem)
        record = self._memory.record
        key = (record.active, record.banks[record.active].sha256, self.tables.key)
        if self._prepared is None or self._prepared[0] != key:
            try:
                self._prepared = key, self.tables.prepare(self.catalogue)
            except (BadInput, CorruptData) as error:
                raise Refusal("incompatible", str(error)) from error
        return self._prepared[1]

    # --- settings -----------------------------------------------------------------------------------------------

    @property
    def commanded(self) -> Commanded:
        """Settings of the operator."""
        radius_rad = self.known.radius_rad(Mode(self.used_mode))
        threshold_dn = float(self.threshold_dn) if self.threshold_dn else None
        return Commanded(threshold_dn, self.min_pixels, max(self.max_pixels, self.min_pixels), radius_rad)

    def _parameters(self, exposure_ms: int, commanded: Commanded, mode: Mode) -> Any:
        exposure_s = max(exposure_ms, 1) / 1000
        return parameters_with(self.tables.parameters, self.tables.profile, exposure_s, commanded, mode)

    def set_hint(self, ra_rad: float, dec_rad: float, roll_rad: float, radius_rad: float) -> None:
        """Set the commanded attitude and its radius (SET_ATTITUDE_HINT)."""
        quaternion = quaternion_from_matrix(cam_from_icrs(ra_rad, dec_rad, roll_rad))
        self.known = replace(self.known, commanded=quaternion, commanded_radius_rad=radius_rad)

    @property
    def quaternion(self) -> NDArray[np.float64] | None:
        """Quaternion of the last attitude, or None."""
        return self.known.quaternion

    # --- imaging ------------------------------------------------------------------------------------------------

    @property
    def slots(self) -> dict[int, StoredFrame]:
        """The image memories."""
        return self.imager.slots

    def capture(self, slot: int, exposure_ms: int, start_s: float) -> StoredFrame:
        """Expose into an image memory; ``start_s``: simulated time of the command."""
        mid_s = self.imager.middle_s(start_s, exposure_ms)
        frame = self.imager.capture(slot, exposure_ms, mid_s, self.device_time(mid_s), self.mode)
        self.timing.capture_ms, self.timing.transfer_ms = self.imager.capture_ms(exposure_ms), self.imager.transfer_ms
        return frame

    # --- the chain ----------------------------------------------------------------------------------------------

    def warm(self) -> None:
        """Process an empty frame and discard the result.

        The chain's first use loads data for a second or more, which would delay a command.
        """
        camera = self.profile.camera
        parameters = self._parameters(self.exposure_ms, Commanded(), Mode.LOST_IN_SPACE)
        work = Work(self.tables.profile.camera, self._catalogue_at_work(), parameters, Mode.LOST_IN_SPACE, None)
        self.chain.find_centroids(np.zeros((camera.rows, camera.columns), np.uint16), work)

    def _work(self, frame: StoredFrame, catalogue: Any) -> Work:
        """Return the task for a frame from the current knowledge."""
        wanted = Mode.LOST_IN_SPACE if self.mode == STANDBY else Mode(self.mode)
        mode = self.known.usable(wanted)
        self.used_mode = mode.value
        parameters = self._parameters(frame.exposure_ms, self.commanded, mode)
        return Work(self.tables.profile.camera, catalogue, parameters, mode, self.known.hint(mode, frame.time_s))

    def find_centroids(self, slot: int) -> Detection:
        """Detect centroids (FIND_CENTROIDS); discards the last matches."""
        frame = self.imager.stored(slot)
        try:
            catalogue = self._catalogue_at_work()
        except Refusal:
            catalogue = None
        work = self._work(frame, catalogue)
        if catalogue is None and work.mode is Mode.TRACKING:
            # Windows are predicted from the catalogue; without one the whole frame is searched.
            work = replace(work, mode=Mode.LOST_IN_SPACE, hint=None)
        if catalogue is None and self.chain.name in NEED_STARS:
            raise Refusal("bank_corrupt", self.catalogue_problem)
        self.frame, self.work = frame, work
        self.matching = self.solution = None
        self.detection = self.chain.find_centroids(frame.pixels, work)
        self.timing.detect_ms = self.chain.detect_ms(frame.pixels.size, self.detection)
        return self.detection

    def match_stars(self) -> Any:
        """Match the last centroids (MATCH_STARS). Reads the bank again, so that the current flash content is used."""
        if self.detection is None or self.frame is None:
            raise Refusal("no_image", "no centroids: FIND_CENTROIDS comes first")
        self.load_catalogue()
        self.solution = None
        self.work = self._work(self.frame, self._catalogue_at_work())
        self.matching = self.chain.match_stars(self.detection.centroids, self.work)
        self.timing.match_ms = self.chain.match_ms(self.matching)
        return self.matching

    def calculate_attitude(self) -> Solution:
        """Calculate the attitude from the last matches (CALCULATE_ATTITUDE) and set the mode of the next iteration."""
        if self.matching is None or self.detection is None or self.frame is None or self.work is None:
            raise Refusal("no_image", "no matches: MATCH_STARS comes first")
        solution = self.chain.calculate_attitude(self.matching, self.detection.centroids, self.work)
        if self.stale and solution.attitude is not None:
            solution = Solution(None, None, solution.false_match_probability, STALE)
        self.solution = solution
        self.timing.attitude_ms = self.chain.attitude_ms(self.matching)
        found = None if solution.attitude is None else np.asarray(solution.attitude.quaternion, float)
        self.known = self.known.after(found)
        if solution.attitude is not None:
            self.sigma_rad = solution.attitude.sigma_rad
            self.attitude_time_s = self.frame.time_s
        if self.mode != STANDBY:
            self.mode = self.chain.next_mode(Mode(self.mode), found is not None).value
        return solution

    def process(self, slot: int) -> list[Report]:
        """Process the image in a slot: one iteration. Returns its telemetry."""
        self.iteration += 1
        frame = self.imager.stored(slot)
        self.timing.match_ms = self.timing.attitude_ms = 0.0
        self.load_catalogue()
        self.detection = self.matching = self.solution = None
        self.frame = frame
        told: list[Report] = []
        try:
            self.find_centroids(slot)
            told.append(self.centroid_report())
            self.match_stars()
            self.calculate_attitude()
            told += [self.match_report(), self.attitude_report()]
        except Refusal as refusal:
            # Without a catalogue nothing is solved, which ends the series of attitudes like an unsolved frame.
            self.matching = self.solution = None
            self.known = self.known.after(None)
            told.append(self.attitude_report(refusal.detail))
        told += [*self.vector_reports(), self.timing_report()]
        if frame.truth is not None:
            told.append(reports.truth_report(frame.number, frame.truth))
        return told

    # --- reports ------------------------------------------------------------------------------------------------

    @property
    def solved(self) -> bool:
        """True if the last calculation found an attitude."""
        return self.solution is not None and self.solution.attitude is not None

    @property
    def frame_number(self) -> int:
        """Frame number of the last results."""
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
        """Return the packet "matched_vectors" if orbit, time and attitude are known, otherwise an empty list."""
        orbit, offset_s = self.known.orbit, self._memory.record.utc_offset_s
        if (
            orbit is None
            or offset_s is None
            or not self.frame
            or not self.work
            or not self.detection
            or not self.solution
        ):
            return []
        utc_s, row = self.frame.time_s + offset_s, self.matching.row
        told = vector_report(self.frame, self.work, self.detection, self.solution, row, orbit, utc_s)
        return [told] if told else []

    def attitude_report(self, problem: str = "") -> Report:
        """Return the packet "attitude"; ``problem``: why there is no attitude."""
        solution = self.solution
        found: dict[str, Value] = {
            "frame_number": self.frame_number,
            "frame_time_s": self.frame.time_s if self.frame else 0.0,
            "mode": self.used_mode,
            "centroids": min(255, len(self.detection.centroids)) if self.detection else 0,
            "matched": self.matched,
            "match_confidence": 100.0 * self.matching.confidence if self.matching is not None else 0.0,
        }
        reason = problem or (solution.reason if solution else "")
        return reports.attitude_report(found, solution.attitude if solution else None, reason)

    @property
    def matched(self) -> int:
        """Number of stars in the last identification."""
        return min(255, len(self.matching.selected)) if self.matching is not None else 0

    def timing_report(self) -> Report:
        """Return the packet "timing"."""
        return reports.timing_report(self.iteration, self.frame_number, self.timing)
