"""Reader of frames from FITS, TIFF, PNG and JPEG files. The format is detected from the content. Unusable files raise BadInput
with the reason."""

from __future__ import annotations

import io
import itertools
import math
import re
import warnings
from dataclasses import dataclass, field
from datetime import datetime
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gss.domain.errors import BadInput
from gss.domain.json_object import JsonObject
from gss.operations.frames.file_optics import check_not_raw, fits_optics, picture_optics
from gss.operations.frames.file_times import exif_time, fits_time

MAX_BYTES = 512 * 1024 * 1024
MAX_PIXELS = 64_000_000
MAX_SIDE_PX = 20_000
MAX_UNPACKED_BYTES = 4 * MAX_PIXELS
"""Maximum unpacked size of a tile-compressed FITS image."""
MAX_TILES = 2 * MAX_SIDE_PX
MAX_EXTENSIONS = 100
MAX_EXPOSURE_S = 86_400.0
MIN_SIDE_PX, ABSURD = 8, 1e30
WITHOUT_ABERRATION = "without_aberration"
"""Key in ``source`` of a frame whose file states that the sky was rendered without aberration. Files of simulated
frames that GSS exported state this."""
JPEG_END, RESTART = b"\xff\xd9", re.compile(rb"\xff[\xd0-\xd7]")
FOREIGN = bytes(range(1, 200)) * 20
"""Arbitrary bytes that contain no JPEG marker."""
LUMINANCE = np.array([0.299, 0.587, 0.114])  # ITU-R BT.601, as most cameras write JPEG
LUMINANCE_32 = LUMINANCE.astype(np.float32)
BAND_ROWS = 64
"""Number of rows of a large image that are converted at a time."""
HINT = "a FITS, PNG, TIFF or JPEG image of the sky"


@dataclass(frozen=True)
class ImportedFrame:
    """One frame as a (rows, columns) array of uint8, uint16 or float32, with metadata from its file.

    ``bits``: number of bits of the converter's range (32 for float). ``exposure_s``, ``taken_at``: None if unknown.
    """

    pixels: NDArray[np.generic]
    bits: int
    exposure_s: float | None
    taken_at: datetime | None
    source: dict[str, str] = field(default_factory=dict)

    @property
    def seen_at(self) -> datetime | None:
        """Time of observation for the correction of aberration. None if the time is unknown or the image contains no
        aberration."""
        return None if WITHOUT_ABERRATION in self.source else self.taken_at


def read_frame(data: bytes, name: str) -> ImportedFrame:
    """Read the frame in the bytes of a file. ``name``: name of the file in messages. Raises BadInput."""
    if not data:
        raise BadInput(f"{name} is empty", expected=HINT, got="0 bytes")
    if len(data) > MAX_BYTES:
        raise BadInput(f"{name} is too large", expected=f"at most {MAX_BYTES >> 20} MiB", got=f"{len(data) >> 20} MiB")
    if data[:10].startswith(b"SIMPLE  ="):
        return _finished(*_read_fits(data, name), name)
    if (
        data[:8] == b"\x89PNG\r\n\x1a\n"
        or data[:3] == b"\xff\xd8\xff"
        or data[:4] in (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
    ):
        return _finished(*_read_picture(data, name), name)
    raise BadInput(f"{name} is not a supported image file", expected=HINT, got=_first_bytes(data))


def _first_bytes(data: bytes) -> str:
    head = data[:12]
    text = head.decode("ascii", "replace")
    return (
        f"a file that begins with {text!r}" if text.isprintable() else f"a file that begins with bytes {head.hex(' ')}"
    )


def _check_size(columns: int, rows: int, name: str) -> None:
    if columns * rows > MAX_PIXELS:
        raise BadInput(
            f"{name} has too many pixels",
            expected=f"at most {MAX_PIXELS // 1_000_000} megapixels",
            got=f"{columns} x {rows} = {columns * rows / 1e6:.0f} megapixels",
            hint="crop or bin the image first",
        )
    if max(columns, rows) > MAX_SIDE_PX:
        raise BadInput(
            f"{name} is too large for a star frame",
            expected=f"sides up to {MAX_SIDE_PX} pixels",
            got=f"{columns} x {rows}",
        )
    if min(columns, rows) < MIN_SIDE_PX:
        raise BadInput(
            f"{name} is too small for a sky frame",
            expected=f"at least {MIN_SIDE_PX} x {MIN_SIDE_PX} pixels",
            got=f"{columns} x {rows}",
        )


def _read_picture(data: bytes, name: str) -> tuple[NDArray[np.generic], JsonObject]:
    from PIL import Image, UnidentifiedImageError

    try:
        with warnings.catch_warnings():
            # Pillow's size warning is ignored, because _check_size enforces a higher limit before pixels are decoded.
            warnings.simplefilter("ignore")
            image = Image.open(io.BytesIO(data), formats=("PNG", "TIFF", "JPEG"))
            check_not_raw(image, data, name)
            _check_size(image.width, image.height, name)
            meta = _picture_meta(image)
            image.load()
            if image.format == "JPEG":
                _check_complete(data, image, name)
            return _luminance(image, name), meta
    except (BadInput, MemoryError):
        raise
    except Image.DecompressionBombError:
        raise BadInput(
            f"{name} has too many pixels when unpacked",
            expected=f"at most {MAX_PIXELS // 1_000_000} megapixels",
            got="a decompression bomb",
        ) from None
    except UnidentifiedImageError:
        raise BadInput(f"{name} cannot be decoded", expected=HINT, got="a damaged or unknown image file") from None
    except Exception as error:  # Pillow's decoders raise OSError, ValueError, SyntaxError, struct.error and more
        raise BadInput(
            f"{name} is damaged",
            expected="a complete image file",
            got=str(error)[:120] or type(error).__name__,
            hint="copy the file again",
        ) from None


def _check_complete(data: bytes, image: Any, name: str) -> None:
    """Raise BadInput if a JPEG file contains less coded data than its header states. The decoder would fill the missing
    pixels with invented values. In a complete image, additional data before the end marker do not change the pixels."""
    from PIL import Image

    end, restarts = data.rfind(JPEG_END), RESTART.findall(data)
    next_restart = bytes((0xFF, 0xD0 + (restarts[-1][1] + 1) % 8)) if restarts else b""
    again = Image.open(io.BytesIO(data[:end] + next_restart + FOREIGN + data[end:]), formats=("JPEG",))
    if again.tobytes() != image.tobytes():
        raise BadInput(
            f"{name} is damaged",
            expected=f"data for {image.width} x {image.height} pixels",
            got="less data than the header states",
            hint="copy the file again",
        )


def _picture_meta(image: Any) -> JsonObject:
    meta: JsonObject = {"format": image.format, "mode": image.mode}
    try:
        exif = image.getexif()
        inner = exif.get_ifd(0x8769)
        seconds = inner.get(0x829A)
        if seconds and _is_plausible_s(float(seconds)):
            meta["exposure_s"] = float(seconds)
        meta["taken_at"] = exif_time(exif, inner)
        meta |= picture_optics(exif, inner, image.size)
    except (ValueError, TypeError, ZeroDivisionError, OSError, SyntaxError, KeyError):
        pass  # a damaged EXIF block does not affect the pixels
    return meta


def _luminance(image: Any, name: str) -> NDArray[np.generic]:
    if image.mode in ("1", "P", "PA", "CMYK", "YCbCr", "HSV", "LAB"):
        image = image.convert("RGB" if image.mode != "1" else "L")
    first = np.asarray(image.crop((0, 0, image.width, 1)))
    if first.ndim == 2:
        return np.asarray(image)
    if first.ndim != 3:
        raise BadInput(
            f"{name} is not an image", expected="rows and columns, grey or colour", got=f"shape {first.shape}"
        )
    # The image is converted in bands, because floats for all channels of a large image would need sixteen times the
    # memory of the image.
    grey = np.empty((image.height, image.width), first.dtype if first.dtype.kind == "u" else np.float32)
    for row in range(0, image.height, BAND_ROWS):
        end_row = min(row + BAND_ROWS, image.height)
        band = np.asarray(image.crop((0, row, image.width, end_row)))
        luminance = band[..., :3].astype(np.float32) @ LUMINANCE_32 if band.shape[2] in (3, 4) else band[..., 0]
        grey[row:end_row] = np.rint(luminance) if grey.dtype.kind == "u" else luminance
    return grey


def _read_fits(data: bytes, name: str) -> tuple[NDArray[np.generic], JsonObject]:
    from astropy.io import fits

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # irregular headers are common and harmless; the data are checked below
            with fits.open(io.BytesIO(data), memmap=False, lazy_load_hdus=True) as hdus:
                for hdu in itertools.islice(hdus, MAX_EXTENSIONS):
                    if getattr(hdu, "is_image", False) and hdu.header.get("NAXIS", 0) >= 2:
                        return _first_plane(hdu, name), _fits_meta(hdu.header)
    except (BadInput, MemoryError):
        raise
    except Exception as error:  # astropy raises OSError, ValueError, TypeError, VerifyError on damaged files
        raise BadInput(
            f"{name} is a damaged FITS file",
            expected="complete header and data",
            got=str(error)[:120] or type(error).__name__,
            hint="copy the file again",
        ) from None
    raise BadInput(
        f"{name} contains no image",
        expected="a FITS extension with rows and columns",
        got="tables or empty headers only",
    )


def _first_plane(hdu: Any, name: str) -> NDArray[np.generic]:
    """Return the first (rows, columns) plane of an image or data cube. Other planes are not read."""
    header = hdu.header
    sides = [int(header[f"NAXIS{k + 1}"]) for k in range(int(header["NAXIS"]))]
    _check_size(sides[0], sides[1], name)
    if math.prod(sides) > 8 * MAX_PIXELS:
        raise BadInput(f"{name} is a data cube that is too large", expected="one image", got=str(hdu.shape))
    if hasattr(hdu, "compression_type"):
        _check_tiles(hdu, name)
    elif len(sides) == 2 and header["BITPIX"] == -64:
        return _read_bands(hdu, name)
    first = (0,) * (len(sides) - 2)
    return np.asarray(hdu.section[(*first, slice(None), slice(None))])


def _check_tiles(hdu: Any, name: str) -> None:
    """Raise BadInput if the first plane of a tile-compressed image is too large when unpacked. Decoding unpacks all
    tiles that contain a part of the plane, so their complete size counts."""
    tile = [min(side, length) for side, length in zip(hdu.tile_shape, hdu.shape, strict=True)]
    tiles = math.prod(-(-length // side) for side, length in zip(tile[-2:], hdu.shape[-2:], strict=True))
    unpacked = tiles * math.prod(tile) * abs(int(hdu.header["BITPIX"])) // 8
    if tiles > MAX_TILES or unpacked > MAX_UNPACKED_BYTES:
        raise BadInput(
            f"{name} is too large when it is unpacked",
            expected=f"at most {MAX_TILES} tiles and {MAX_UNPACKED_BYTES >> 20} MiB",
            got=f"{tiles} tiles, {unpacked >> 20} MiB",
            hint="save it without compression, or with one row per tile",
        )


def _read_bands(hdu: Any, name: str) -> NDArray[np.float32]:
    """Check double-precision pixels and convert them to float32. This is done in bands, because a full copy with temporary arrays
    would need too much memory."""
    rows, columns = hdu.shape
    pixels, not_finite = np.empty((rows, columns), np.float32), 0
    for row in range(0, rows, BAND_ROWS):
        band = np.asarray(hdu.section[row : min(row + BAND_ROWS, rows)], np.float64)
        finite = np.isfinite(band)
        not_finite += int((~finite).sum())
        # Values outside the range of float32 are clipped to values above the limit of ``_check_real``, which reports them.
        pixels[row : row + len(band)] = np.where(finite, np.clip(band, -2 * ABSURD, 2 * ABSURD), np.nan)
    _check_real(not_finite, pixels, name)
    return pixels


def _fits_meta(header: Any) -> JsonObject:
    meta: JsonObject = {"format": "FITS", "bitpix": str(header.get("BITPIX"))}
    for key in ("EXPTIME", "EXPOSURE"):
        value = header.get(key)
        if isinstance(value, int | float) and _is_plausible_s(value):
            meta["exposure_s"] = float(value)
            break
    try:
        meta["taken_at"] = fits_time(header)
    except ValueError:
        meta |= {key.lower(): header[key] for key in ("DATE-OBS", "TIMESYS") if key in header}
    if header.get("GSSABERR") is False:
        meta[WITHOUT_ABERRATION] = "yes"
    for key in ("INSTRUME", "TELESCOP", "OBJECT"):
        if isinstance(header.get(key), str):
            meta[key.lower()] = header[key]
    return meta | fits_optics(header)


def _is_plausible_s(exposure_s: float) -> bool:
    return 0 < exposure_s <= MAX_EXPOSURE_S


def _finished(array: NDArray[np.generic], meta: JsonObject, name: str) -> ImportedFrame:
    """Check the pixel values, convert them to one of the three types, and return the frame."""
    pixels, bits = _plain(array, name)
    exposure, taken_at = meta.pop("exposure_s", None), meta.pop("taken_at", None)
    return ImportedFrame(np.ascontiguousarray(pixels), bits, exposure, taken_at, {k: str(v) for k, v in meta.items()})


def _plain(array: NDArray[np.generic], name: str) -> tuple[NDArray[np.generic], int]:
    kind = array.dtype.kind
    if kind not in "uifb":
        raise BadInput(
            f"{name} does not contain plain numbers", expected="integer or real pixels", got=str(array.dtype)
        )
    if kind == "f":
        return _real(array, name)
    low, high = (int(array.min()), int(array.max())) if kind != "b" else (0, 1)
    if low >= 0 and array.dtype.itemsize == 1:
        return array.astype(np.uint8, copy=False), 8
    if low >= 0 and high <= 0xFFFF:
        return array.astype(np.uint16, copy=False), 16
    return array.astype(np.float32), 32


def _real(array: NDArray[np.generic], name: str) -> tuple[NDArray[np.generic], int]:
    bands = range(0, len(array), BAND_ROWS)
    not_finite = sum(int((~np.isfinite(array[row : row + BAND_ROWS])).sum()) for row in bands)
    _check_real(not_finite, array, name)
    return array.astype(np.float32, copy=False), 32


def _check_real(not_finite: int, array: NDArray[np.generic], name: str) -> None:
    if not_finite:
        all_pixels = not_finite == array.size
        raise BadInput(
            f"{name} has {'only' if all_pixels else 'some'} pixels that are not numbers",
            expected="finite values in all pixels",
            got="NaN or infinity everywhere" if all_pixels else f"{not_finite} of {array.size} pixels NaN or infinite",
            hint="replace blanked pixels by the local sky level",
        )
    largest = max(float(array.max()), -float(array.min()))
    if largest > ABSURD:
        raise BadInput(f"{name} has implausible pixel values", expected="below 1e30", got=f"{largest:.3g}")
