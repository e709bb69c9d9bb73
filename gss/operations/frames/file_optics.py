"""Detector and lens data in image files: pixel size, focal length, aperture, size of the original image."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from gss.domain.errors import BadInput

RAW_TAGS = (0xC612, 0xC614)
"""TIFF tags "DNG version" and "unique camera model". A file with these tags begins with a small preview, which decoders
return as the image."""
INCH_MM, UNIT_MM = 25.4, {2: 25.4, 3: 10.0, 4: 1.0, 5: 1e-3}
"""Millimetres per unit of EXIF's FocalPlaneResolutionUnit."""
PIXEL_UM, FOCAL_MM, F_NUMBER = (1e-1, 200.0), (0.1, 10_000.0), (0.1, 200.0)
"""Plausible ranges of pixel size, focal length and f-number."""


def check_not_raw(image: Any, data: bytes, name: str) -> None:
    """Raise BadInput for the raw file of a photographic camera (DNG, CR2, NEF), whose first image is only a preview."""
    if image.format != "TIFF":
        return
    canon, reduced = data[8:10] == b"CR", image.tag_v2.get(0xFE) == 1
    if canon or reduced or set(image.tag_v2) & set(RAW_TAGS):
        raise BadInput(
            f"{name} is a raw file of a photographic camera",
            expected="pixels in the file",
            got="a preview and coded sensor data",
            hint="convert it to TIFF or FITS with 16 bits, linear, without denoising and lens correction",
        )


def picture_optics(exif: Mapping[int, Any], inner: Mapping[int, Any], size: tuple[int, int]) -> dict[str, str]:
    """Return the optical data in the EXIF blocks. The result has no pixel size if the image was resized after the
    exposure."""
    values = {
        "focal_mm": _within(inner.get(0x920A), FOCAL_MM),
        "f_number": _within(inner.get(0x829D), F_NUMBER),
    }
    original = [n for n in (inner.get(0xA002), inner.get(0xA003)) if isinstance(n, int) and n > 0]
    resized = len(original) == len(size) and sorted(original) != sorted(size)
    per_unit = _within(inner.get(0xA20E), (1e-6, 1e9))
    if per_unit is not None and not resized:
        values["pixel_um"] = _within(1e3 * UNIT_MM.get(inner.get(0xA210, 2), INCH_MM) / per_unit, PIXEL_UM)
    facts = {name: f"{value:g}" for name, value in values.items() if value is not None}
    if exif.get(0x0110):
        facts["camera"] = str(exif.get(0x0110)).strip("\0 ")
    return facts | ({"original_px": f"{original[0]} x {original[1]}"} if resized else {})


def fits_optics(header: Mapping[str, Any]) -> dict[str, str]:
    """Return the optical data in the FITS header. By convention, XPIXSZ is in micrometres and includes binning."""
    values = {
        "pixel_um": _within(header.get("XPIXSZ"), PIXEL_UM),
        "focal_mm": _within(header.get("FOCALLEN"), FOCAL_MM),
    }
    return {name: f"{value:g}" for name, value in values.items() if value is not None}


def _within(value: Any, limits: tuple[float, float]) -> float | None:
    """Return the value as a number if it is within the limits, otherwise None. Errors are ignored, because a damaged header does
    not affect the pixels."""
    try:
        number = float(value)
    except (TypeError, ValueError, ZeroDivisionError):
        return None
    return number if math.isfinite(number) and limits[0] <= number <= limits[1] else None
