"""The star tracker's own work: expose, detect, match, attitude, with the chain's functions and the active bank's bytes.

No link here. Durations are the document's scale, computed from counted operations (Erlank 2013 §5.3.3–5.3.6):
10 MB/s sensor read-out after 70 ms, 1 MB/s copy to the processor, 320 ms for twenty centroids, under 10 ms for QUEST.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gss.catalogue_tools.onboard import decode
from gss.device.dictionary import Value
from gss.device.simulator.memory import Memory
from gss.device.simulator.sky import Sky
from gss.domain.angles import ARCSEC_RAD
from gss.domain.errors import BadInput, CorruptData
from gss.domain.frames import cam_from_icrs, ra_dec_roll_rad
from gss.domain.profiles import CameraProfile
from gss.domain.results import Truth
from gss.domain.rotation import matrix_from_quaternion, quaternion_from_matrix
from gss.domain.stars import OnboardCatalogue
from gss.pipeline.chains import cubestar
from gss.pipeline.chains.cubestar import Detection, Solution
from gss.pipeline.chains.cubestar_match import Matching
from gss.pipeline.chains.cubestar_modes import Hint, Mode

SLOTS = 4
THUMBNAIL_BINNING = 4
STANDBY = "standby"
SENSOR_START_MS = 70.0
SENSOR_BYTES_PER_MS = 10_000.0
COPY_BYTES_PER_MS = 1_000.0
SAMPLE_MS, REGION_MS = 0.001, 1.0
PAIR_MS, HIT_MS, ATTITUDE_MS, VECTOR_MS = 0.05, 0.02, 7.0, 0.1
Row = Mapping[str, Value]
Pixels = NDArray[np.uint8] | NDArray[np.uint16]
Report = tuple[str, dict[str, Value], dict[str, list[Row]]]
"""A telemetry packet to send: name, values, lists."""


class Refusal(Exception):
    """A command cannot be carried out: the dictionary's reason and a sentence."""

    def __init__(self, reason: str, detail: str) -> None:
        super().__init__(detail)
        self.reason, self.detail = reason, detail


@dataclass(frozen=True)
class StoredFrame:
    """One image memory. ``time_s``: device time of mid-exposure. ``truth`` only for what the simulated sky drew."""

    number: int
    slot: int
    pixels: Pixels
    exposure_ms: int
    time_s: float
    source: str
    mode: str
    bits: int
    truth: Truth | None = None

    @property
    def data(self) -> bytes:
        """Rows top to bottom; one byte per pixel up to eight bits, else two, high byte first."""
        return frame_bytes(self.pixels)


@dataclass
class Timing:
    """Milliseconds of the last iteration."""

    capture_ms: float = 0.0
    transfer_ms: float = 0.0
    detect_ms: float = 0.0
    match_ms: float = 0.0
    attitude_ms: float = 0.0


def frame_bytes(pixels: Pixels) -> bytes:
    """Pixels as the link carries them."""
    return pixels.tobytes() if pixels.dtype == np.uint8 else pixels.astype(">u2").tobytes()


def thumbnail(pixels: Pixels) -> Pixels:
    """Blocks of 4x4 pixels averaged; a rest at the right and bottom edge is left out."""
    n = THUMBNAIL_BINNING
    rows, columns = pixels.shape[0] // n * n, pixels.shape[1] // n * n
    blocks = pixels[:rows, :columns].reshape(rows // n, n, columns // n, n)
    mean = np.asarray(np.rint(blocks.mean(axis=(1, 3))))
    return mean.astype(np.uint8) if pixels.dtype == np.uint8 else mean.astype(np.uint16)


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
        reports = [self.centroid_report()]
        if self.load_catalogue():
            reports.append(self.attitude_report(self.catalogue_problem))
        else:
            self.match_stars()
            self.calculate_attitude()
            reports += [self.match_report(), self.attitude_report()]
        reports.append(self.timing_report())
        if frame.truth is not None:
            reports.append(truth_report(frame.number, frame.truth))
        return reports

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
        c = self.detection.centroids
        rows: list[Row] = [
            {
                "col_px": float(c.col_px[i]),
                "row_px": float(c.row_px[i]),
                "flux_dn": float(c.flux_dn[i]),
                "peak_dn": int(c.peak_dn[i]),
                "area_px": int(c.area_px[i]),
            }
            for i in range(len(c))
        ]
        values: dict[str, Value] = {
            "frame_number": self.frame_number,
            "regions_invalid": min(255, self.detection.invalid),
        }
        values["background_dn"] = float(self.detection.black_dn)
        return "centroids", values, {"items": rows}

    def match_report(self) -> Report:
        """Packet "matches": the stars of the attitude, or the verified ones before it is known."""
        matching = self.matching
        assert matching is not None  # noqa: S101 - callers have just matched
        rows: list[Row] = [
            {"centroid": int(i), "star": int(matching.row[i]), "weight": float(matching.verification_votes[i])}
            for i in matching.selected
        ]
        return "matches", {"frame_number": self.frame_number}, {"items": rows}

    def attitude_report(self, problem: str = "") -> Report:
        """Packet "attitude"."""
        solution, frame = self.solution, self.frame
        attitude = solution.attitude if solution else None
        reason = problem or (solution.reason if solution else "")
        values: dict[str, Value] = {
            "frame_number": self.frame_number,
            "frame_time_s": frame.time_s if frame else 0.0,
            "mode": self.used_mode,
            "outcome": "solved" if attitude else "none",
            "centroids": len(self.detection.centroids) if self.detection else 0,
            "matched": self.matched,
            "match_confidence": 100.0 * self.matching.confidence if self.matching else 0.0,
            "reason": reason.encode()[:200].decode(errors="ignore"),
        }
        sigma_rad = attitude.sigma_rad if attitude else (float("nan"), float("nan"))
        values["sigma_cross_arcsec"], values["sigma_roll_arcsec"] = (s / ARCSEC_RAD for s in sigma_rad)
        return "attitude", values | pose_values(attitude.quaternion if attitude else None), {}

    @property
    def matched(self) -> int:
        """Stars of the last identification."""
        return len(self.matching.selected) if self.matching else 0

    def timing_report(self) -> Report:
        """Packet "timing"."""
        values: dict[str, Value] = {"iteration": self.iteration, "frame_number": self.frame_number}
        return "timing", values | timing_values(self.timing), {}

    def frame_report(self, frame: StoredFrame) -> Report:
        """Packet "frame_info"."""
        rows, columns = frame.pixels.shape
        values: dict[str, Value] = {
            "frame_number": frame.number,
            "slot": frame.slot,
            "source": frame.source,
            "exposure_ms": frame.exposure_ms,
            "frame_time_s": frame.time_s,
            "columns": columns,
            "rows": rows,
            "bits": frame.bits,
            "mode": frame.mode,
            "sha256": hashlib.sha256(frame.data).digest(),
        }
        return "frame_info", values, {}


def timing_values(timing: Timing) -> dict[str, Value]:
    """Whole milliseconds, as the wire has them."""
    return {name: min(0xFFFF, round(value)) for name, value in vars(timing).items()}


def pose_values(quaternion: NDArray[np.float64] | None) -> dict[str, Value]:
    """Quaternion, boresight and roll in degrees; NaN without an attitude."""
    names = ("quaternion_x", "quaternion_y", "quaternion_z", "quaternion_w", "ra_deg", "dec_deg", "roll_deg")
    if quaternion is None:
        return dict.fromkeys(names, float("nan"))
    angles = np.degrees(ra_dec_roll_rad(matrix_from_quaternion(quaternion)))
    return dict(zip(names, map(float, (*quaternion, *angles)), strict=True))


def truth_report(frame_number: int, truth: Truth) -> Report:
    """Packet "frame_truth", which no real device has."""
    return "frame_truth", {"frame_number": frame_number} | pose_values(truth.quaternion), {}
