"""Dark frames of detector calibrations. They are stored as blobs, loaded when frames are processed, and displayed as pictures."""

from __future__ import annotations

import base64
import io
import threading
import zipfile
from collections.abc import Callable, Mapping
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from gss.domain.errors import CorruptData
from gss.domain.json_object import JsonObject
from gss.operations.frames.pictures import DisplayRange, apply, png
from gss.pipeline.calibration.dark import DarkCalibration, Response
from gss.pipeline.fixed_pattern import DarkPattern

DARK = "dark frame"
"""Key in a profile's ``sources``. Its value is the blob key of the active dark frame."""
KEPT_IN_MEMORY = 4
MAX_BYTES = 256 << 20
"""Maximum size of an unpacked dark frame: twice the size of a half-precision map of the largest detector."""
GREYS = 16
"""Number of grey levels in the picture. Further levels cannot be distinguished, and would only enlarge the file with
noise."""


class Bytes(Protocol):
    """A store of bytes whose keys are the hashes of their content."""

    def put(self, data: bytes) -> str: ...

    def get(self, key: str) -> bytes: ...


class DarkFrames:
    """Stores and loads dark frames. The last few are cached in memory."""

    def __init__(self, blobs: Bytes) -> None:
        self._blobs = blobs
        self._lock = threading.Lock()
        self._read: dict[str, DarkPattern] = {}

    def keep(self, dark: DarkCalibration, even: Response | None) -> JsonObject:
        """Store the map of a dark calibration with its bad pixels. Return its entry for the calibration's result: key, number of
        bad pixels, exposure and picture."""
        return self.keep_pattern(pattern_of(dark, even))

    def keep_pattern(self, pattern: DarkPattern) -> JsonObject:
        """Store a map and return its entry for the calibration's result. The picture is None if the map contains only bad
        pixels."""
        return {
            "key": self._blobs.put(as_bytes(pattern)),
            "bad": len(pattern.bad),
            "exposure_s": pattern.exposure_s,
            "picture": picture_of(pattern.pattern_dn) if pattern.pattern_dn.any() else None,
        }

    def bad_pixels(self, entry: Any) -> NDArray[np.intp]:
        """Return the (k, 2) bad pixels, col and row, of a calibration's entry; none without an entry, or if the entry is
        the key of a dark frame that was only used. Raises CorruptData or NotFound."""
        if not isinstance(entry, Mapping):
            return np.zeros((0, 2), np.intp)
        return self.pattern(str(entry["key"])).bad

    def pattern(self, key: str) -> DarkPattern:
        """Return the map with this key. Raises CorruptData or NotFound."""
        with self._lock:
            if key not in self._read:
                while len(self._read) >= KEPT_IN_MEMORY:
                    self._read.pop(next(iter(self._read)))
                self._read[key] = from_bytes(self._blobs.get(key))
            return self._read[key]


Pattern = Callable[[str], DarkPattern]


def pattern_of(dark: DarkCalibration, even: Response | None = None) -> DarkPattern:
    """Return the map of a dark calibration. ``even``: response measured with flat fields, which shows the dead pixels."""
    dead = np.zeros((0, 2), np.intp) if even is None else even.dead
    bad = np.unique(np.concatenate([dark.hot, dark.noisy, dead]).reshape(-1, 2), axis=0)
    level = np.float32(np.median(dark.median_dn))
    return DarkPattern((dark.median_dn - level).astype(np.float32), bad.astype(np.intp), dark.exposure_s)


def as_bytes(pattern: DarkPattern) -> bytes:
    """Return a map as compressed bytes in half precision. Half precision resolves 1 DN at a level of 2048 DN, and much
    smaller steps at the level of ordinary pixels."""
    buffer = io.BytesIO()
    small = np.clip(pattern.pattern_dn, -60000, 60000).astype(np.float16)
    np.savez_compressed(
        buffer, pattern_dn=small, bad=pattern.bad.astype(np.int32), exposure_s=np.float64(pattern.exposure_s)
    )
    return buffer.getvalue()


def from_bytes(data: bytes) -> DarkPattern:
    """Restore a map from the bytes of :func:`as_bytes`. Raises CorruptData if the bytes are not a valid map."""
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            size = sum(member.file_size for member in archive.infolist())
        if size > MAX_BYTES:
            raise ValueError(f"{size} bytes when it is unpacked, more than {MAX_BYTES}")
        with np.load(io.BytesIO(data), allow_pickle=False) as arrays:
            return DarkPattern(
                arrays["pattern_dn"].astype(np.float32), arrays["bad"].astype(np.intp), float(arrays["exposure_s"])
            )
    except Exception as error:  # zipfile, zlib and numpy raise many types of exceptions for damaged data
        raise CorruptData("the file is not a dark frame", got=f"{type(error).__name__}: {error}") from None


def picture_of(pattern_dn: NDArray[np.float32]) -> JsonObject:
    """Return a picture as {"png": base64, "low_dn", "high_dn"}. Black is the 0.1 % percentile and white the 99.9 % percentile, so
    hot pixels are white."""
    low, high = (float(v) for v in np.percentile(pattern_dn, [0.1, 99.9]))
    high = max(high, low + 1.0)
    grey = apply(pattern_dn, DisplayRange(low, high, asinh=False))
    coarse = (grey.astype(np.uint16) * GREYS // 256 * (255 // (GREYS - 1))).astype(np.uint8)
    return {"png": base64.b64encode(png(coarse, 6)).decode("ascii"), "low_dn": low, "high_dn": high}
