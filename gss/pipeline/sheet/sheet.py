"""The performance sheet: all rows, in the order of ECSS-E-ST-60-20C."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from gss.domain.angles import ARCSEC_RAD, Array
from gss.domain.camera import Camera
from gss.domain.errors import BadInput
from gss.pipeline.analysis.series import AttitudeSeries
from gss.pipeline.sheet.ageing import Ageing
from gss.pipeline.sheet.heads import Fitted, ReferenceErrors, ReferenceInput, reference_errors
from gss.pipeline.sheet.noise import TemporalNoise, temporal_noise
from gss.pipeline.sheet.pattern import PatternError, pattern_error
from gss.pipeline.sheet.rows import SheetFigure, SheetRow, axis_rows, counted_conditions, missing
from gss.pipeline.sheet.spatial import SpatialErrors, StarError, StarSightings, spatial_errors
from gss.pipeline.sheet.trials import (
    ROBUSTNESS,
    Trials,
    acquisition_row,
    condition_row,
    end_of_life_row,
    tracking_row,
)

BIAS = ("bias", "Bias", "mean rotation from the reference, relative to the mounting from ground alignment")
THERMAL = ("thermo-elastic", "Thermo-elastic error", "rotation from the reference, regressed on temperature")
FIELD = (
    "field-of-view",
    "Field-of-view spatial error",
    "slow variation of the star residuals over the detector, converted to attitude error; rms over the frames",
)
PIXEL = (
    "pixel",
    "Pixel spatial error",
    "star residuals that are periodic in a pixel or recur at the same pixel, converted to attitude errors",
)
NOISE = ("temporal-noise", "Temporal noise (NEA)", "each attitude against the mean of its neighbours; robust, 1 σ")
ABERRATION = (
    "aberration",
    "Aberration error",
    "rotation from the reference, regressed on the aberration at the known velocity",
)
DATE = ("date", "Measurement date error", "rotation from the reference, regressed on the angular rate")


@dataclass(frozen=True)
class SheetInput:
    """Data of one unit. ``series``: attitudes in order of time; ``residuals``: stars of the same frames, None if there
    are none. ``reference``: input of the rows that need a second head. ``ageing``: ageing measured in the frames.
    ``acquisition``, ``aged``, ``disturbed``: trials with a known truth."""

    camera: Camera
    series: AttitudeSeries
    residuals: StarSightings | None = None
    reference: ReferenceInput | None = None
    acquisition: Trials | None = None
    ageing: Ageing | None = None
    aged: tuple[Trials, ...] = ()
    disturbed: tuple[Trials, ...] = ()


@dataclass(frozen=True)
class PerformanceSheet:
    """Performance sheet: all rows, and the analyses behind them, for plots."""

    rows: tuple[SheetRow, ...]
    spatial: SpatialErrors | None = None
    noise: TemporalNoise | None = None
    reference: ReferenceErrors | None = None
    problems: tuple[str, ...] = field(default=())

    def row(self, key: str) -> SheetRow:
        """Return the row with that key. Raises KeyError."""
        for row in self.rows:
            if row.key == key:
                return row
        raise KeyError(key)


def performance_sheet(sheet_input: SheetInput, rng: np.random.Generator) -> PerformanceSheet:
    """Compute all rows. A row without figures states the missing data."""
    spatial, pattern, problem = _spatial(sheet_input, rng)
    noise = temporal_noise(sheet_input.series, sheet_input.camera, rng)
    reference, apart = _reference(sheet_input.reference, rng)
    rows = (
        _bias(reference, sheet_input.reference, apart),
        _thermal(reference, sheet_input.reference, apart),
        _field_row(spatial, sheet_input.camera, problem),
        _pixel_row(spatial, pattern, problem),
        _noise_row(noise),
        _aberration_row(reference, sheet_input.reference, apart),
        _date_row(reference, apart),
        acquisition_row(sheet_input.acquisition, sheet_input.series),
        tracking_row(sheet_input.series, sheet_input.camera),
        end_of_life_row(sheet_input.ageing, sheet_input.aged),
        condition_row(ROBUSTNESS, sheet_input.disturbed, "frames with the disturbance; a simulated unit has them"),
    )
    return PerformanceSheet(rows, spatial, noise, reference, tuple(p for p in (problem, apart) if p))


def _spatial(
    sheet_input: SheetInput, rng: np.random.Generator
) -> tuple[SpatialErrors | None, PatternError | None, str]:
    if sheet_input.residuals is None:
        return None, None, "identified stars with their residuals"
    try:
        spatial = spatial_errors(sheet_input.residuals, sheet_input.camera, rng)
    except BadInput as error:
        return None, None, f"{error.expected} (there are {error.got})"
    try:
        return spatial, pattern_error(sheet_input.residuals, spatial, rng), ""
    except BadInput:
        return spatial, None, ""


def _reference(reference: ReferenceInput | None, rng: np.random.Generator) -> tuple[ReferenceErrors | None, str]:
    if reference is None:
        return None, ""
    try:
        return reference_errors(reference, rng), ""
    except BadInput as error:
        return None, str(error)


def _bias(errors: ReferenceErrors | None, reference: ReferenceInput | None, problem: str) -> SheetRow:
    if errors is None or reference is None:
        return missing(*BIAS, problem or "frames of a second head taken at the same times, or reference attitudes")
    if errors.bias is None:
        return missing(*BIAS, "the mounting from ground alignment (quaternion camera from reference)")
    figures = axis_rows(errors.bias.value, errors.bias.low, errors.bias.high, "rad")
    if errors.drift is not None:
        figures += axis_rows(errors.drift.value, errors.drift.low, errors.drift.high, "rad/d", "drift ")
    return SheetRow(*BIAS, _condition(errors), errors.pairs, figures)


def _thermal(errors: ReferenceErrors | None, reference: ReferenceInput | None, problem: str) -> SheetRow:
    if errors is None or reference is None:
        return missing(*THERMAL, problem or "frames of a second head, and telemetry of the temperature")
    if errors.thermal is None:
        return missing(*THERMAL, "temperatures of the unit that vary by at least 2 K during the frames")
    return SheetRow(
        *THERMAL,
        f"{errors.span_k:.1f} K around {errors.middle_c:.1f} °C; linear",
        errors.pairs,
        axis_rows(errors.thermal.value, errors.thermal.low, errors.thermal.high, "rad/K"),
    )


def _condition(errors: ReferenceErrors) -> str:
    return counted_conditions(
        [
            f"mean temperature {errors.middle_c:.1f} °C" if errors.span_k else "",
            f"rates up to {np.degrees(errors.rate_rad_s):.3g}°/s",
        ]
    )


def _field_row(spatial: SpatialErrors | None, camera: Camera, problem: str) -> SheetRow:
    if spatial is None:
        return missing(*FIELD, problem)
    e = spatial.field
    star = _star("one star", spatial.field_star)
    text = (
        f"{spatial.sightings} stars; polynomial of degree {spatial.degree}, features wider than about "
        f"{camera.columns / spatial.degree:.0f} px; 1 px is {camera.pixel_rad / ARCSEC_RAD:.1f}″"
    )
    return SheetRow(*FIELD, text, spatial.frames, (*axis_rows(e.value_rad, e.low_rad, e.high_rad, "rad"), star))


def _pixel_row(spatial: SpatialErrors | None, pattern: PatternError | None, problem: str) -> SheetRow:
    if spatial is None:
        return missing(*PIXEL, problem)
    e = spatial.phase
    star = _star("one star, periodic", spatial.phase_star)
    figures = (*axis_rows(e.value_rad, e.low_rad, e.high_rad, "rad", "periodic "), star)
    if pattern is None:
        text = "fixed pattern not measured: too few stars return to the same pixels"
        return SheetRow(*PIXEL, text, spatial.frames, figures)
    fixed = axis_rows(pattern.value_rad, pattern.low_rad, pattern.high_rad, "rad", "fixed ")
    single_star = SheetFigure("one star, fixed", pattern.value_px, pattern.low_px, pattern.high_px, "px")
    text = f"{pattern.pairs} returns of {pattern.stars} stars; 'fixed' includes the periodic part"
    return SheetRow(*PIXEL, text, spatial.frames, (*figures, *fixed, single_star))


def _noise_row(noise: TemporalNoise | None) -> SheetRow:
    if noise is None:
        return missing(*NOISE, "at least 22 frames taken one after the other at equal intervals")
    moved = f"stars move {noise.motion_px:.2g} px from frame to frame"
    text = moved if noise.still else f"{moved}: includes the pixel spatial error"
    return SheetRow(*NOISE, text, noise.frames, axis_rows(noise.nea_rad, noise.low_rad, noise.high_rad, "rad"))


def _aberration_row(errors: ReferenceErrors | None, reference: ReferenceInput | None, problem: str) -> SheetRow:
    if errors is None or reference is None:
        return missing(*ABERRATION, problem or "a reference, and the velocity of the unit")
    if errors.aberration is None:
        return missing(*ABERRATION, "the velocity of the unit, and directions in which its aberration differs by 1″")
    return SheetRow(
        *ABERRATION,
        "1 is the whole aberration, 0 a complete correction",
        errors.pairs,
        (_single("remaining share", errors.aberration, "1"),),
    )


def _date_row(errors: ReferenceErrors | None, problem: str) -> SheetRow:
    if errors is None:
        return missing(*DATE, problem or "frames of a second head, or a reference, at changing rates")
    if errors.date_s is None:
        return missing(*DATE, "rates that change by at least 0.02°/s during the frames")
    text = f"rates up to {np.degrees(errors.rate_rad_s):.3g}°/s; positive: measured later than stated"
    return SheetRow(*DATE, text, errors.pairs, (_single("date error", errors.date_s, "s"),))


def _single(name: str, fit: Fitted, unit: str) -> SheetFigure:
    values: list[Array] = [fit.value, fit.low, fit.high]
    value, low, high = (float(v[0]) for v in values)
    return SheetFigure(name, value, low, high, unit)


def _star(name: str, error: StarError) -> SheetFigure:
    return SheetFigure(name, error.value_px, error.low_px, error.high_px, "px")
