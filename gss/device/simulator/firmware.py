"""The star tracker's own work: detect, match, attitude, with the chain of its system and the bytes of the active banks.

No link here. What is in the active tables decides chain, camera and constants; durations are the chain's, from its
document's figures and counted work.
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
"""Chains whose search for stars asks the catalogue how faint they are."""
STALE = "the attitude is not renewed"

__all__ = ["STANDBY", "Refusal", "StarTracker"]


class StarTracker:
    """Settings and results. Methods that cannot do their work raise Refusal. ``device_time``: the device's clock at a
    simulated time; its owner sets it."""

    def __init__(self, profile: CameraProfile, sky: Sky, memory: Memory) -> None:
        self.profile, self.sky, self._memory = profile, sky, memory
        self.imager = Imager(profile, sky, memory)
        self.tables = Tables(profile, memory)
        self.device_time: Callable[[float], float] = lambda simulated_s: simulated_s
        self.stale = False
        self.restart()

    def restart(self) -> None:
        """As after power-on: settings from profile and tables, nothing known. The catalogue comes from the active bank."""
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

    # --- what is in flash ---------------------------------------------------------------------------------------

    def load_tables(self) -> list[str]:
        """Read the active tables; what is wrong with them. Detection is set as the constants say."""
        problems = self.tables.load()
        parameters = self._parameters(self.exposure_ms, Commanded(), Mode.LOST_IN_SPACE)
        # FAR-MST's threshold follows from each frame's noise: 0 stands for that until one is commanded.
        self.threshold_dn = round(getattr(parameters, "threshold_dn", None) or 0)
        self.min_pixels, self.max_pixels = int(parameters.min_area_px), int(parameters.max_area_px)
        return problems

    @property
    def chain(self) -> OnboardChain:
        """The chain that the active parameters are for."""
        return self.tables.chain

    def load_catalogue(self) -> str:
        """Read the active bank; the reason if it cannot be used, "" otherwise."""
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
        """Why the chain could not match from a readable bank, as without the magnitudes that it goes by; "" where it can."""
        try:
            catalogue = decode(self._memory.content(bank))
        except (CorruptData, BadInput):
            return ""  # a damaged bank is told where it is read
        try:
            # Not with the active triplet table, which belongs to the bank before; what it lacks is told at the first image.
            self.chain.prepare(catalogue, self.profile)
        except (BadInput, CorruptData) as error:
            return str(error)
        return ""

    def _catalogue_at_work(self) -> Any:
        """What the chain made of bank and triplets when they were read; made anew when either changed."""
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
        """What the operator has set."""
        radius_rad = self.known.radius_rad(Mode(self.used_mode))
        threshold_dn = float(self.threshold_dn) if self.threshold_dn else None
        return Commanded(threshold_dn, self.min_pixels, max(self.max_pixels, self.min_pixels), radius_rad)

    def _parameters(self, exposure_ms: int, commanded: Commanded, mode: Mode) -> Any:
        exposure_s = max(exposure_ms, 1) / 1000
        return parameters_with(self.tables.parameters, self.tables.profile, exposure_s, commanded, mode)

    def set_hint(self, ra_rad: float, dec_rad: float, roll_rad: float, radius_rad: float) -> None:
        """SET_ATTITUDE_HINT."""
        quaternion = quaternion_from_matrix(cam_from_icrs(ra_rad, dec_rad, roll_rad))
        self.known = replace(self.known, commanded=quaternion, commanded_radius_rad=radius_rad)

    @property
    def quaternion(self) -> NDArray[np.float64] | None:
        """Of the last attitude."""
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
        """Search an empty frame, and keep nothing of it: what the chain loads at its first use takes a second or more, and no
        command may wait for that."""
        camera = self.profile.camera
        parameters = self._parameters(self.exposure_ms, Commanded(), Mode.LOST_IN_SPACE)
        work = Work(self.tables.profile.camera, self._catalogue_at_work(), parameters, Mode.LOST_IN_SPACE, None)
        self.chain.find_centroids(np.zeros((camera.rows, camera.columns), np.uint16), work)

    def _work(self, frame: StoredFrame, catalogue: Any) -> Work:
        """The task of a frame by what is known now."""
        wanted = Mode.LOST_IN_SPACE if self.mode == STANDBY else Mode(self.mode)
        mode = self.known.usable(wanted)
        self.used_mode = mode.value
        parameters = self._parameters(frame.exposure_ms, self.commanded, mode)
        return Work(self.tables.profile.camera, catalogue, parameters, mode, self.known.hint(mode, frame.time_s))

    def find_centroids(self, slot: int) -> Detection:
        """FIND_CENTROIDS; forgets what was matched before."""
        frame = self.imager.stored(slot)
        try:
            catalogue = self._catalogue_at_work()
        except Refusal:
            catalogue = None
        work = self._work(frame, catalogue)
        if catalogue is None and work.mode is Mode.TRACKING:
            # Windows are predicted from the catalogue: without one the whole frame is searched.
            work = replace(work, mode=Mode.LOST_IN_SPACE, hint=None)
        if catalogue is None and self.chain.name in NEED_STARS:
            raise Refusal("bank_corrupt", self.catalogue_problem)
        self.frame, self.work = frame, work
        self.matching = self.solution = None
        self.detection = self.chain.find_centroids(frame.pixels, work)
        self.timing.detect_ms = self.chain.detect_ms(frame.pixels.size, self.detection)
        return self.detection

    def match_stars(self) -> Any:
        """MATCH_STARS on the centroids found last. Reads the bank anew: the catalogue is what flash holds now."""
        if self.detection is None or self.frame is None:
            raise Refusal("no_image", "no centroids: FIND_CENTROIDS comes first")
        self.load_catalogue()
        self.solution = None
        self.work = self._work(self.frame, self._catalogue_at_work())
        self.matching = self.chain.match_stars(self.detection.centroids, self.work)
        self.timing.match_ms = self.chain.match_ms(self.matching)
        return self.matching

    def calculate_attitude(self) -> Solution:
        """CALCULATE_ATTITUDE on the matches made last; sets the mode of the next iteration."""
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
        """Everything after the image: one iteration's packets."""
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
            # No catalogue, no knowledge: what is not found breaks the row of attitudes all the same.
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
        """Did the last calculation find an attitude?"""
        return self.solution is not None and self.solution.attitude is not None

    @property
    def frame_number(self) -> int:
        """Of the frame the last results belong to."""
        return self.frame.number if self.frame else 0

    def centroid_report(self) -> Report:
        """Packet "centroids"."""
        assert self.detection is not None  # noqa: S101 - callers have just detected
        return reports.centroid_report(self.frame_number, self.detection)

    def match_report(self) -> Report:
        """Packet "matches"."""
        assert self.matching is not None  # noqa: S101 - callers have just matched
        return reports.match_report(self.frame_number, self.matching)

    def vector_reports(self) -> list[Report]:
        """Packet "matched_vectors" where an orbit is known, the clock is set and an attitude was found."""
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
        """Packet "attitude"; ``problem``: why there can be none."""
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
        """Stars of the last identification."""
        return min(255, len(self.matching.selected)) if self.matching is not None else 0

    def timing_report(self) -> Report:
        """Packet "timing"."""
        return reports.timing_report(self.iteration, self.frame_number, self.timing)
