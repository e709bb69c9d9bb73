"""Camera of the unit: exposures into image memories, and imager faults."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gss.device.simulator.images import Pixels, StoredFrame
from gss.device.simulator.memory import Memory
from gss.device.simulator.rejection import Rejection
from gss.device.simulator.sky import SimulatedSky
from gss.domain.camera_profile import CameraProfile
from gss.instruments.package_files import UnitTiming

GLARE = 1.0
SHARED_PERIOD = 0.5
DOT_SIGMA_PX = 1.2


@dataclass
class ImagerFaults:
    """Imager faults for training. ``dots``: number of false stars per image."""

    stuck: bool = False
    blinded: bool = False
    dots: int = 0


class Imager:
    """Simulated camera: exposes the simulated sky into image memories.

    ``timing``: times of sensor start, readout, and copying to the processor.
    """

    def __init__(self, profile: CameraProfile, sky: SimulatedSky, memory: Memory, timing: UnitTiming) -> None:
        self._timing = timing
        self.profile, self._sky, self._memory = profile, sky, memory
        self.faults = ImagerFaults()
        self._last: Pixels | None = None
        self.restart()

    def restart(self) -> None:
        """Empty the image memories and reset the gain to the profile's."""
        self.gain = 1
        self.repeated = False
        self.slots: dict[int, StoredFrame] = {}

    @property
    def frame_size(self) -> int:
        """Size in bytes of one image as read out, with the dark columns."""
        sensor = self.profile.sensor
        return self.upload_size + self.profile.camera.rows * sensor.dark_columns.count * (1 if sensor.bits <= 8 else 2)

    @property
    def upload_size(self) -> int:
        """Size in bytes of an uploaded image, which has no dark columns."""
        camera = self.profile.camera
        return camera.columns * camera.rows * (1 if self.profile.sensor.bits <= 8 else 2)

    @property
    def start_ms(self) -> float:
        """Time in ms to start the sensor, which is part of the capture time."""
        return self._timing.sensor_start_ms

    @property
    def readout_ms(self) -> float:
        """Time in ms to read an image out of the sensor."""
        return self.frame_size / self._timing.readout_bytes_ms

    def capture_ms(self, exposure_ms: int) -> float:
        """Return the time from the start of the sensor until the image is in the FPGA's memory."""
        return self._exposed_ms(exposure_ms) + self.readout_ms

    def _exposed_ms(self, exposure_ms: int) -> float:
        """Return the time from the start of the sensor until the readout begins. A rolling-shutter imager first reads
        out an image of undefined exposure, which takes one frame period; the rows are exposed at the end of this period
        (Erlank 2013 app. D)."""
        if not self._timing.frame_ms:
            return self._timing.sensor_start_ms + exposure_ms
        return min((t for t in self._timing.frame_ms if t >= exposure_ms), default=float(exposure_ms))

    def occupied_ms(self, exposure_ms: int) -> float:
        """Return the time until the next exposure can begin: the next exposure can overlap with the readout."""
        return self._exposed_ms(exposure_ms) if self._timing.readout_overlaps else self.capture_ms(exposure_ms)

    @property
    def overlapped_ms(self) -> float:
        """Part of the readout, in ms, that takes place in the next period."""
        return self.readout_ms if self._timing.readout_overlaps else 0.0

    @property
    def transfer_ms(self) -> float:
        """Time in ms to copy an image from the FPGA's memory to the processor; 0 if the processor uses the FPGA's
        memory directly."""
        return self.frame_size / self._timing.copy_bytes_ms if self._timing.copy_bytes_ms else 0.0

    def longest_ms(self, period_ms: int) -> int:
        """Return the longest exposure in a cycle, in ms. Start, exposure and readout use the whole period (Jacobs 1995
        §4.2) or share it with the copy, which takes half of the period in CubeStar (Erlank 2013 §5.3.6)."""
        share = SHARED_PERIOD if self._timing.copy_bytes_ms else 1.0
        if self._timing.frame_ms:
            fitting = [t for t in self._timing.frame_ms if t <= share * period_ms - self.readout_ms]
            return int(max(fitting, default=min(self._timing.frame_ms)))
        return max(1, int(share * period_ms - self.occupied_ms(0)))

    def middle_s(self, start_s: float, exposure_ms: int) -> float:
        """Return the time of mid-exposure of an image commanded at ``start_s``. For a rolling shutter, this is the
        mid-exposure of the middle row."""
        rolled_ms = self.readout_ms / 2 if self._timing.frame_ms else 0.0
        return start_s + (self._exposed_ms(exposure_ms) - exposure_ms / 2 + rolled_ms) / 1000

    def capture(self, slot: int, exposure_ms: int, mid_s: float, device_s: float, mode: str) -> StoredFrame:
        """Expose into an image memory. ``mid_s``: mid-exposure in simulated time; ``device_s``: mid-exposure in device
        time."""
        record = self._memory.record
        record.frames += 1
        exposure = self._sky.expose(mid_s, exposure_ms / 1000, record.frames)
        pixels = self._with_faults(self._amplified(exposure.pixels), record.frames)
        dark = None if exposure.dark is None else self._amplified(exposure.dark)
        self.repeated = (
            self._last is not None and self._last.shape == pixels.shape and bool((self._last == pixels).all())
        )
        self._last = pixels
        sensor = self.profile.sensor
        frame = StoredFrame(
            record.frames,
            slot,
            pixels,
            exposure_ms,
            device_s,
            "captured",
            mode,
            sensor.bits,
            exposure.truth,
            dark,
            sensor.dark_columns,
        )
        self.slots[slot] = frame
        return frame

    def _amplified(self, pixels: Pixels) -> Pixels:
        """Return the pixels with the signal above the bias multiplied by the commanded gain, clipped at the converter's
        maximum."""
        if self.gain == 1:
            return pixels
        sensor = self.profile.sensor
        signal = (pixels.astype(float) - sensor.bias_dn) * self.gain + sensor.bias_dn
        return self._converted(signal, pixels)

    def _converted(self, signal_dn: np.ndarray, like: Pixels) -> Pixels:
        cut = np.rint(np.clip(signal_dn, 0, self.profile.sensor.saturation_dn))
        converted: Pixels = cut.astype(np.uint8) if like.dtype == np.uint8 else cut.astype(np.uint16)
        return converted

    def _with_faults(self, pixels: Pixels, number: int) -> Pixels:
        if self.faults.stuck and self._last is not None and self._last.shape == pixels.shape:
            return self._last
        top = self.profile.sensor.saturation_dn
        if self.faults.blinded:
            pixels = self._converted(pixels + GLARE * top, pixels)
        if self.faults.dots:
            rng = np.random.default_rng([number, self.faults.dots])
            signal = pixels.astype(float)
            rows, columns = signal.shape
            for _ in range(self.faults.dots):
                col, row = rng.uniform(4, columns - 5), rng.uniform(4, rows - 5)
                c, r = int(col), int(row)
                y, x = np.mgrid[r - 4 : r + 5, c - 4 : c + 5]
                spot = np.exp(-((x - col) ** 2 + (y - row) ** 2) / (2 * DOT_SIGMA_PX**2))
                signal[r - 4 : r + 5, c - 4 : c + 5] += rng.uniform(0.3, 0.9) * top * spot
            pixels = self._converted(signal, pixels)
        return pixels

    def put_image(self, slot: int, data: bytes, exposure_ms: int, device_s: float, mode: str) -> StoredFrame:
        """Store an uploaded image in a slot."""
        camera, sensor = self.profile.camera, self.profile.sensor
        kind = np.uint8 if sensor.bits <= 8 else np.dtype(">u2")
        flat = np.frombuffer(data, kind).reshape(camera.rows, camera.columns)
        pixels: Pixels = flat.astype(np.uint8) if sensor.bits <= 8 else flat.astype(np.uint16)
        self._memory.record.frames += 1
        number = self._memory.record.frames
        frame = StoredFrame(number, slot, pixels, exposure_ms, device_s, "uploaded", mode, sensor.bits)
        self.slots[slot] = frame
        return frame

    def stored(self, slot: int) -> StoredFrame:
        """Return the image in a slot. Raises Rejection if it is empty."""
        if slot not in self.slots:
            raise Rejection("no_image", f"slot {slot} contains no image")
        return self.slots[slot]

    def sram(self, address: int, length: int) -> bytes:
        """Return bytes of the image memories, which are contiguous. Empty memories read as zeros."""
        size = self.frame_size
        first, last = address // size, (address + max(0, length - 1)) // size
        memory = bytearray()
        for slot in range(first, last + 1):
            data = self.slots[slot].data if slot in self.slots else b""
            memory += data.ljust(size, b"\0")
        start = address - first * size
        return bytes(memory[start : start + length])
