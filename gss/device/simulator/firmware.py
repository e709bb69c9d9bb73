"""The star tracker's own work: expose, detect, match, attitude, with the chain's functions and the active bank's bytes.

No link here. Durations are the document's scale, computed from counted operations (Erlank 2013 §5.3.3–5.3.6):
10 MB/s sensor read-out after 70 ms, 1 MB/s copy to the processor, 320 ms for twenty centroids, under 10 ms for QUEST.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from gss.catalogue_tools.onboard import decode
from gss.device.dictionary import Value
from gss.device.simulator import reports
from gss.device.simulator.images import Pixels, StoredFrame
from gss.device.simulator.memory import Memory
from gss.device.simulator.reports import Report, Timing
from gss.device.simulator.sky import Sky
from gss.domain.errors import BadInput, CorruptData
from gss.domain.frames import cam_from_icrs
from gss.domain.profiles import CameraProfile
from gss.domain.rotation import quaternion_from_matrix
from gss.domain.stars import OnboardCatalogue
from gss.pipeline.chains import cubestar
from gss.pipeline.chains.cubestar import Detection, Solution
from gss.pipeline.chains.cubestar_match import Matching
from gss.pipeline.chains.modes import Hint, Mode

STANDBY = "standby"
SENSOR_START_MS = 70.0
SENSOR_BYTES_PER_MS = 10_000.0
COPY_BYTES_PER_MS = 1_000.0
SAMPLE_MS, REGION_MS = 0.001, 1.0
PAIR_MS, HIT_MS, ATTITUDE_MS, VECTOR_MS = 0.05, 0.02, 7.0, 0.1


class Refusal(Exception):
    """A command cannot be carried out: the dictionary's reason and a sentence."""

    def __init__(self, reason: str, detail: str) -> None:
        super().__init__(detail)
        self.reason, self.detail = reason, detail


class StarTracker:
    """Settings, image memories and results. Methods that cannot do their work raise Refusal."""

    def __init__(self, profile: CameraProfile, sky: Sky, memory: Memory) -> None:
        self.profile, self._sky, self._memory = profile, sky, memory
        self.restart()

    def restart(self) -> None:
        """As after power-on: settings from the profile, image memory empty. The catalogue comes from the active bank."""
        sensor = self.profile.sensor
        self.mode = "lost_in_space"
        self.exposure_ms = round(sensor.exposure_s * 1000)
        parameters = cubestar.default_parameters(self.profile)
        self.threshold_dn = min(255, round(parameters.threshold_dn))
        self.min_pixels, self.max_pixels = parameters.min_area_px, parameters.max_area_px
        self.hint: Hint | None = None
        self.hint_radius_rad = float(np.radians(5.0))
        self.slots: dict[int, StoredFrame] = {}
        self.frame: StoredFrame | None = None
        self.detection: Detection | None = None
        self.matching: Matching | None = None
        self.solution: Solution | None = None
        self.used_mode = "lost_in_space"
        self.quaternion: NDArray[np.float64] | None = None
        self.sigma_rad = (float("nan"), float("nan"))
        self.attitude_time_s: float | None = None
        self.iteration = 0
        self.timing = Timing()
        self.load_catalogue()

    # --- catalogue ----------------------------------------------------------------------------------------------

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

    def rate_rad_s(self, time_s: float) -> float:
        """Angular rate; a real unit would take it from successive attitudes."""
        return self._sky.rate_rad_s(time_s)

    # --- imaging ------------------------------------------------------------------------------------------------

    def capture_ms(self, exposure_ms: int) -> float:
        """From the start of the sensor to the image in the FPGA's memory."""
        return SENSOR_START_MS + exposure_ms + self.frame_size / SENSOR_BYTES_PER_MS

    @property
    def frame_size(self) -> int:
        """Bytes of one image."""
        camera = self.profile.camera
        return camera.columns * camera.rows * (1 if self.profile.sensor.bits <= 8 else 2)

    @property
    def transfer_ms(self) -> float:
        """From the FPGA's memory to the processor's."""
        return self.frame_size / COPY_BYTES_PER_MS

    def capture(self, slot: int, exposure_ms: int, start_s: float) -> StoredFrame:
        """Expose into an image memory. The exposure begins 70 ms after ``start_s``: the first image is thrown away."""
        record = self._memory.record
        record.frames += 1
        exposure_s = exposure_ms / 1000
        mid_s = start_s + SENSOR_START_MS / 1000 + exposure_s / 2
        drawn = self._sky.expose(mid_s, exposure_s, record.frames)
        frame = StoredFrame(
            record.frames,
            slot,
            drawn.pixels,
            exposure_ms,
            mid_s,
            "captured",
            self.mode,
            self.profile.sensor.bits,
            drawn.truth,
        )
        self.slots[slot] = frame
        self.timing.capture_ms, self.timing.transfer_ms = self.capture_ms(exposure_ms), self.transfer_ms
        return frame

    def put_image(self, slot: int, data: bytes, time_s: float) -> StoredFrame:
        """An uploaded image takes a memory."""
        camera, sensor = self.profile.camera, self.profile.sensor
        kind = np.uint8 if sensor.bits <= 8 else np.dtype(">u2")
        flat = np.frombuffer(data, kind).reshape(camera.rows, camera.columns)
        pixels: Pixels = flat.astype(np.uint8) if sensor.bits <= 8 else flat.astype(np.uint16)
        self._memory.record.frames += 1
        number = self._memory.record.frames
        frame = StoredFrame(number, slot, pixels, self.exposure_ms, time_s, "uploaded", self.mode, sensor.bits)
        self.slots[slot] = frame
        return frame

    def stored(self, slot: int) -> StoredFrame:
        """The image in a memory."""
        if slot not in self.slots:
            raise Refusal("no_image", f"slot {slot} holds no image")
        return self.slots[slot]

    # --- the chain ----------------------------------------------------------------------------------------------

    def _parameters(self, exposure_ms: int) -> cubestar.CubestarParameters:
        base = cubestar.default_parameters(self.profile, max(exposure_ms, 1) / 1000)
        radius_rad = base.assisted_radius_rad
        if self.used_mode == "assisted":
            radius_rad = min(np.pi, self.profile.camera.half_diagonal_rad + self.hint_radius_rad)
        return replace(
            base,
            threshold_dn=float(self.threshold_dn),
            min_area_px=self.min_pixels,
            max_area_px=max(self.max_pixels, self.min_pixels),
            assisted_radius_rad=float(radius_rad),
        )

    def find_centroids(self, slot: int) -> Detection:
        """FIND_CENTROIDS; forgets what was matched before."""
        self.frame = self.stored(slot)
        self.matching = self.solution = None
        self.detection = cubestar.find_centroids(self.frame.pixels, self._parameters(self.frame.exposure_ms))
        samples = self.frame.pixels.size / 9
        regions = len(self.detection.centroids) + self.detection.invalid
        self.timing.detect_ms = SAMPLE_MS * samples + REGION_MS * regions
        return self.detection

    def match_stars(self) -> Matching:
        """MATCH_STARS on the centroids found last. Reads the bank anew: the catalogue is what flash holds now."""
        if self.detection is None or self.frame is None:
            raise Refusal("no_image", "no centroids: FIND_CENTROIDS comes first")
        self.load_catalogue()
        if self.catalogue is None:
            raise Refusal("bank_corrupt", self.catalogue_problem)
        self.solution = None
        mode = self._usable_mode()
        self.matching = cubestar.match_stars(
            self.detection.centroids,
            self.profile.camera,
            self.catalogue,
            self._parameters(self.frame.exposure_ms),
            mode,
            self._hint_for(mode),
        )
        n = len(self.matching.row)
        self.timing.match_ms = PAIR_MS * n * (n - 1) + HIT_MS * self.matching.hits
        return self.matching

    def _usable_mode(self) -> Mode:
        """The mode as far as there is the knowledge for it."""
        wanted = self.mode
        if wanted == "tracking" and self.quaternion is None:
            wanted = "assisted"
        if wanted == "assisted" and self.hint is None and self.quaternion is None:
            wanted = "lost_in_space"
        self.used_mode = "lost_in_space" if wanted == STANDBY else wanted
        return Mode(self.used_mode)

    def _hint_for(self, mode: Mode) -> Hint | None:
        if mode is Mode.LOST_IN_SPACE:
            return None
        last = Hint.from_quaternion(self.quaternion) if self.quaternion is not None else None
        return last if mode is Mode.TRACKING else self.hint or last

    def calculate_attitude(self) -> Solution:
        """CALCULATE_ATTITUDE on the matches made last; sets the mode of the next iteration."""
        if self.matching is None or self.detection is None or self.frame is None or self.catalogue is None:
            raise Refusal("no_image", "no matches: MATCH_STARS comes first")
        self.solution = cubestar.calculate_attitude(
            self.matching,
            self.detection.centroids,
            self.profile.camera,
            self.catalogue,
            self._parameters(self.frame.exposure_ms),
            self._hint_for(self.matching.mode),
        )
        self.timing.attitude_ms = ATTITUDE_MS + VECTOR_MS * len(self.matching.selected)
        solved = self.solution.attitude is not None
        if self.solution.attitude is not None:
            self.quaternion = np.asarray(self.solution.attitude.quaternion, float)
            self.sigma_rad = self.solution.attitude.sigma_rad
            self.attitude_time_s = self.frame.time_s
            self.hint = None
        if self.mode != STANDBY:
            self.mode = cubestar.next_mode(Mode(self.mode), solved).value
        return self.solution

    def process(self, slot: int) -> list[Report]:
        """Everything after the image: one iteration's packets."""
        self.iteration += 1
        frame = self.stored(slot)
        self.timing.match_ms = self.timing.attitude_ms = 0.0
        self.find_centroids(slot)
        told = [self.centroid_report()]
        if self.load_catalogue():
            told.append(self.attitude_report(self.catalogue_problem))
        else:
            self.match_stars()
            self.calculate_attitude()
            told += [self.match_report(), self.attitude_report()]
        told.append(self.timing_report())
        if frame.truth is not None:
            told.append(reports.truth_report(frame.number, frame.truth))
        return told

    def set_hint(self, ra_rad: float, dec_rad: float, roll_rad: float, radius_rad: float) -> None:
        """SET_ATTITUDE_HINT."""
        self.hint = Hint.from_quaternion(quaternion_from_matrix(cam_from_icrs(ra_rad, dec_rad, roll_rad)))
        self.hint_radius_rad = radius_rad

    # --- reports ------------------------------------------------------------------------------------------------

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

    def attitude_report(self, problem: str = "") -> Report:
        """Packet "attitude"; ``problem``: why there can be none."""
        solution = self.solution
        found: dict[str, Value] = {
            "frame_number": self.frame_number,
            "frame_time_s": self.frame.time_s if self.frame else 0.0,
            "mode": self.used_mode,
            "centroids": len(self.detection.centroids) if self.detection else 0,
            "matched": self.matched,
            "match_confidence": 100.0 * self.matching.confidence if self.matching else 0.0,
        }
        reason = problem or (solution.reason if solution else "")
        return reports.attitude_report(found, solution.attitude if solution else None, reason)

    @property
    def matched(self) -> int:
        """Stars of the last identification."""
        return len(self.matching.selected) if self.matching else 0

    def timing_report(self) -> Report:
        """Packet "timing"."""
        return reports.timing_report(self.iteration, self.frame_number, self.timing)
