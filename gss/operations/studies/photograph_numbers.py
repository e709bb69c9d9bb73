"""Camera file derived from photographs: measured numbers have an uncertainty, chosen numbers have a reason."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import NotRequired, TypedDict

import numpy as np

from gss.instruments.camera_file import CameraFile
from gss.operations.studies.photograph_camera import PhotographCamera
from gss.pipeline.calibration.lens_models import BROWN
from gss.pipeline.calibration.robust import robust_sigma

REFRACTION_ERROR = 4e-4
"""Relative error of the scale caused by refraction. Refraction compresses the sky by 2.8e-4 at the zenith. At an
elevation of 45°, it compresses the vertical direction by twice this value."""
ABERRATION_ERROR = 6e-5
"""Relative error of the scale if the date is unknown. Aberration changes the scale by up to 1e-4 during a year."""
CENTRE_SHARE = 0.12
"""Standard deviation of the distance of an unknown camera's optical axis from the middle, as a share of the width."""
BRIGHT_RANGE_MAG = 8.0
MAX_BITS = 16
TYPICAL_PITCH_MM, TYPICAL_F_NUMBER = 0.005, 2.0
TYPICAL = "typical of a small camera; the photographs do not determine it"
SHAPE_ERROR = 0.01
"""Relative error of a star's width. It allows for the difference between the image of a star and a Gaussian."""
MEDIAN_SIGMA_RATIO = 1.2533  # ratio of the standard error of a median to the standard error of a mean


@dataclass(frozen=True)
class Stated:
    """Properties of the camera that the user or the files state; None if unknown. ``atmosphere``: False for frames from
    space and for simulated frames."""

    pixel_um: float | None
    focal_mm: float | None
    f_number: float | None
    atmosphere: bool


class FileNumber(TypedDict):
    """A number of the file. ``source``: source of a measured number; ``chosen``: reason for a chosen number; ``sigma``:
    standard deviation."""

    value: float
    unit: str
    sigma: NotRequired[float]
    source: NotRequired[str]
    chosen: NotRequired[str]


FilePart = dict[str, FileNumber]
"""Numbers of a part of the file, by name."""


class _Numbers:
    """Creates numbers of the file. ``origin``: common part of their sources."""

    def __init__(self, origin: str) -> None:
        self.origin = origin

    def measured(self, value: float, unit: str, sigma: float, detail: str = "") -> FileNumber:
        text = f"{self.origin}; {detail}" if detail else self.origin
        return {"value": rounded(value, sigma), "unit": unit, "sigma": significant(sigma), "source": text[:400]}

    def exact(self, value: float, unit: str, detail: str = "") -> FileNumber:
        return {"value": value, "unit": unit, "source": f"{self.origin}; {detail}" if detail else self.origin}


def chosen(value: float, unit: str, reason: str, sigma: float | None = None) -> FileNumber:
    """Return a number that was chosen instead of measured, with the reason."""
    number: FileNumber = {"value": value, "unit": unit, "chosen": reason[:400]}
    if sigma is not None:
        number["sigma"] = significant(sigma)
    return number


def significant(sigma: float) -> float:
    """Round an uncertainty to two significant digits."""
    return float(f"{sigma:.2g}") if math.isfinite(sigma) else 0.0


def rounded(value: float, sigma: float) -> float:
    """Round a value so that the rounding error is below a hundredth of its uncertainty."""
    if not (math.isfinite(sigma) and sigma > 0):
        return float(f"{value:.10g}")
    return float(round(float(value), 3 - math.floor(math.log10(sigma))))


def camera_file(measured: PhotographCamera, stated: Stated, origin: str) -> CameraFile:
    """Return the camera file. ``origin``: source of the measured numbers. Raises BadInput if a number is outside its
    range."""
    numbers = _Numbers(origin)
    geometry, gain = _geometry(measured, stated, numbers), _gain(measured, numbers)
    return CameraFile.model_validate(
        {
            "geometry": geometry,
            "lens": _lens(measured, numbers),
            "detector": _detector(measured, numbers, gain),
            "limits": _limits(measured, numbers),
            "baffle": _baffle(),
        }
    )


def spread_factor(measured: PhotographCamera) -> float:
    """Return the factor for all uncertainties of the geometry. Photographs of one field have the same errors, so
    together they count as only one measurement."""
    return math.sqrt(len(measured.photographs.used)) if measured.same_field else 1.0


def _geometry(measured: PhotographCamera, stated: Stated, numbers: _Numbers) -> FilePart:
    camera, fit = measured.geometry.camera, measured.geometry
    covariance = dict.fromkeys(("focal_px", "aspect"), 0.0) | {
        p.name: p.sigma**2 for p in fit.parameters if p.name in ("focal_px", "aspect")
    }
    focal_px = math.sqrt(camera.focal_col_px * camera.focal_row_px)
    aspect = camera.focal_col_px / camera.focal_row_px
    relative = covariance["focal_px"] / focal_px**2 + covariance["aspect"] / (2 * aspect) ** 2
    if {"focal_px", "aspect"} <= set(fit.names):
        i, j = fit.names.index("focal_px"), fit.names.index("aspect")
        relative += float(fit.covariance[i, j]) / (focal_px * aspect)
    noise = spread_factor(measured) * math.sqrt(max(relative, 0.0))
    dates_known = all(s.photograph.shot.observer is not None for s in measured.photographs.used)
    systematic = (
        (0.0 if dates_known or not stated.atmosphere else ABERRATION_ERROR),
        (REFRACTION_ERROR if stated.atmosphere else 0.0),
    )
    sigma = math.hypot(noise, *systematic)
    pitch_mm, pitch_reason = _pitch(stated, camera.focal_col_px)
    detail = f"{camera.focal_col_px:.2f} px ± {camera.focal_col_px * noise:.2f} px from the scatter of the stars"
    if stated.atmosphere:
        detail += f", and {systematic[1]:.0e} for refraction" + (
            "" if dates_known else f" and {systematic[0]:.0e} for an unknown date"
        )
    size = "size of the images"
    row_sigma = spread_factor(measured) * math.sqrt(covariance["aspect"]) * pitch_mm
    square = "aspect" not in fit.names
    return {
        "columns": numbers.exact(camera.columns, "px", size),
        "rows": numbers.exact(camera.rows, "px", size),
        "pitch_column": chosen(pitch_mm, "mm", pitch_reason),
        "pitch_row": chosen(pitch_mm * aspect, "mm", "square pixels; the stars do not determine the aspect ratio")
        if square
        else numbers.measured(pitch_mm * aspect, "mm", row_sigma, "aspect ratio times pitch_column"),
        "focal_length": numbers.measured(
            camera.focal_col_px * pitch_mm, "mm", camera.focal_col_px * pitch_mm * sigma, detail
        ),
        "f_number": chosen(stated.f_number, "1", "stated by the user or the files")
        if stated.f_number
        else chosen(TYPICAL_F_NUMBER, "1", TYPICAL),
        "centre_column": _centre(measured, numbers, "centre_col_px", camera.centre_col_px),
        "centre_row": _centre(measured, numbers, "centre_row_px", camera.centre_row_px),
    }


def _pitch(stated: Stated, focal_px: float) -> tuple[float, str]:
    if stated.pixel_um is not None:
        return stated.pixel_um / 1000, "pixel size as stated by the user or the files"
    if stated.focal_mm is not None:
        reason = f"from the nominal focal length of {stated.focal_mm:g} mm and the measured focal length in pixels"
        return float(f"{stated.focal_mm / focal_px:.6g}"), reason
    return (
        TYPICAL_PITCH_MM,
        "unknown; photographs determine the focal length only in pixels, so any pixel size is consistent with focal_length",
    )


def _centre(measured: PhotographCamera, numbers: _Numbers, name: str, value: float) -> FileNumber:
    max_sigma_px = CENTRE_SHARE * measured.geometry.camera.columns
    frozen = next((f for f in measured.geometry.frozen if f.name == name), None)
    if frozen is not None:
        fit_sigma = f" (σ would be {frozen.sigma:.0f} px)" if math.isfinite(frozen.sigma) else ""
        reason = f"middle of the detector, because the photographs do not determine it{fit_sigma}; σ is typical of unknown cameras"
        return chosen(
            value, "px", reason, min(frozen.sigma, max_sigma_px) if math.isfinite(frozen.sigma) else max_sigma_px
        )
    sigma = spread_factor(measured) * measured.geometry.parameter(name).sigma
    one_field = "; poorly determined, because all photographs show one field" if measured.same_field else ""
    return numbers.measured(
        value, "px", min(sigma, max_sigma_px), f"for the lens model {measured.geometry.model}{one_field}"
    )


def _lens(measured: PhotographCamera, numbers: _Numbers) -> Mapping[str, str | FileNumber]:
    fit, why = measured.geometry, model_reason(measured)
    if fit.model == "pinhole":
        return {"model": "pinhole", "source": f"{numbers.origin}; {why}"[:400]}
    lens: dict[str, str | FileNumber] = {"model": "brown"}
    frozen = {f.name: f for f in fit.frozen}
    for name in BROWN:
        value = float(getattr(fit.camera.distortion, name))
        if name in fit.names:
            lens[name] = numbers.measured(value, "1", spread_factor(measured) * fit.parameter(name).sigma, why)
        elif name in frozen:
            lens[name] = chosen(value, "1", f"not determined: {frozen[name].reason}")
        else:
            lens[name] = chosen(0.0, "1", f"not part of the model {fit.model}; {why}")
    return lens


def model_reason(measured: PhotographCamera) -> str:
    """Return the reason for the choice of the lens model."""
    rows = measured.geometry.comparison
    best = next(r for r in rows if r.chosen)
    others = ", ".join(f"{r.model} {r.bic:+.0f}" for r in rows if not r.chosen)
    return f"{best.model} has the smallest BIC (others: {others}); residual of left-out photographs {best.held_out_px:.2f} px"


def _gain(measured: PhotographCamera, numbers: _Numbers) -> FileNumber:
    sky = measured.sky
    if math.isfinite(sky.gain_e_per_dn):
        detail = "variance of the sky pixels as a function of their level"
        return numbers.measured(sky.gain_e_per_dn, "e/DN", sky.gain_sigma, detail)
    why = "the sky's level varies too little" if measured.linear else "the files are not linear (JPEG or colour)"
    return chosen(
        1.0, "e/DN", f"{why}; it can be measured with pairs of flat fields. All values in electrons depend on it"
    )


def _detector(measured: PhotographCamera, numbers: _Numbers, gain: FileNumber) -> FilePart:
    sky, e_per_dn = measured.sky, float(gain["value"])
    exposure_s, _ = exposure(measured)
    bits, reason = converter_bits(measured)
    bias = max(sky.level_dn, 0.0)
    full_well = e_per_dn * ((1 << bits) - 1 - bias)
    read_sigma, gain_share = sky.noise_sigma * e_per_dn, float(gain.get("sigma", 0.0)) / e_per_dn
    noise_e = math.sqrt(max(sky.noise_dn**2 - 1 / 12, 0.0)) * e_per_dn
    background = sky.excess_dn * e_per_dn / exposure_s
    detector: FilePart = {
        "bits": chosen(bits, "bit", reason),
        "gain": gain,
        "bias": numbers.measured(
            bias, "DN", sky.level_sigma, "sky level in the darkest photograph; without dark frames an upper limit"
        ),
        "full_well": chosen(
            float(f"{max(full_well, 1.0):.6g}"), "e", "range of the converter above the bias, times the gain"
        ),
        "read_noise": numbers.measured(
            noise_e,
            "e",
            math.hypot(read_sigma, noise_e * gain_share),
            "noise of the darkest photograph, including the shot noise of the sky",
        ),
        "dark_current": chosen(0.0, "e/s", "included in the background; it can be measured with dark frames"),
        "background": numbers.measured(
            background,
            "e/s",
            max(sky.excess_sigma * e_per_dn / exposure_s, background * gain_share),
            "sky level above the darkest photograph",
        ),
        "psf_sigma": _width(measured, numbers),
    }
    if measured.light is None:
        return detector | {
            "zero_point": chosen(1e5, "e/s", next(m for m in measured.missing if m.startswith("zero point")))
        }
    zero = measured.light.zero_point_dn_s * e_per_dn
    share = math.hypot(0.4 * math.log(10) * measured.light.zero_point_sigma_mag, gain_share)
    detail = f"V {measured.light.zero_point_mag:.2f} for 1 DN/s at {exposure_s:g} s, with B−V = 0, times the gain"
    return detector | {"zero_point": numbers.measured(zero, "e/s", zero * share, detail)}


def _width(measured: PhotographCamera, numbers: _Numbers) -> FileNumber:
    if measured.spots is None:
        reason = next(m for m in measured.missing if m.startswith("width"))
        return chosen(1.0, "px", reason)
    spots = measured.spots
    count, width = len(spots.sigma_px), min(max(spots.typical_sigma_px, 0.05), 50.0)
    sigma = MEDIAN_SIGMA_RATIO * robust_sigma(spots.sigma_px) / math.sqrt(count)
    detail = (
        f"median of {count} stars, FWHM {2.3548 * width:.2f} px without the width of a pixel; "
        "the uncertainty includes 1 % for the star's shape"
    )
    return numbers.measured(width, "px", math.hypot(sigma, SHAPE_ERROR * width), detail)


def converter_bits(measured: PhotographCamera) -> tuple[int, str]:
    """Return the number of bits of the converter, with the reason. A file with 16 bits per pixel often contains only 12
    or 14 significant bits."""
    file_bits = min(max(s.photograph.shot.bits for s in measured.photographs.used), MAX_BITS)
    largest, times = measured.sky.largest_dn, measured.sky.largest_count
    bits = math.ceil(math.log2(largest + 1)) if largest >= 1 else file_bits
    if 8 <= bits < file_bits and largest == (1 << bits) - 1 and times > 1:
        return bits, f"{times} pixels reach {largest:.0f} and no pixel exceeds this value"
    return file_bits, "bits of the files"


def exposure(measured: PhotographCamera) -> tuple[float, str]:
    """Return the typical exposure in seconds, with its origin."""
    exposures_s = [s.photograph.shot.exposure_s for s in measured.photographs.used if s.photograph.shot.exposure_s]
    if len(exposures_s) == len(measured.photographs.used):
        return float(np.median(exposures_s)), "median of the photographs"
    return 1.0, "not stated by the files; values per second depend on it"


def _limits(measured: PhotographCamera, numbers: _Numbers) -> FilePart:
    exposure_s, why = exposure(measured)
    times = [s.photograph.shot.exposure_s or exposure_s for s in measured.photographs.used]
    matched = np.concatenate([s.stars.v_mag for s in measured.photographs.used])
    if measured.limit is not None:
        detail = f"half of the catalogue's stars are detected at {exposure_s:g} s"
        faintest = numbers.measured(measured.limit.mag_50, "mag", measured.limit.sigma_50, detail)
    else:
        reason = next(m for m in measured.missing if m.startswith("limiting"))
        faintest = chosen(round(float(matched.max()), 2), "mag", f"faintest identified star; {reason}")
    bright = measured.light.saturation_mag if measured.light is not None else math.nan
    if math.isfinite(bright) and bright < faintest["value"] - 1:
        brightest = chosen(round(bright, 2), "mag", f"a typical star saturates at {exposure_s:g} s")
    else:
        brightest = chosen(
            round(faintest["value"] - BRIGHT_RANGE_MAG, 2), "mag", "no star near saturation was measured"
        )
    return {
        "brightest": brightest,
        "faintest": faintest,
        "exposure_min": chosen(min(times), "s", f"shortest of the photographs; {why}"),
        "exposure_max": chosen(max(times), "s", f"longest of the photographs; {why}"),
        "exposure": chosen(exposure_s, "s", why),
    }


def _baffle() -> FilePart:
    values = {
        "sun": (40, "deg"),
        "earth": (30, "deg"),
        "blind": (20, "deg"),
        "decay": (3, "deg"),
        "stray_light": (100, "e/s"),
    }
    return {name: chosen(value, unit, TYPICAL) for name, (value, unit) in values.items()}
