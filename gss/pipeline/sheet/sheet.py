"""The performance sheet: all rows, in the order of ECSS-E-ST-60-20C."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from gss.domain.angles import ARCSEC_RAD, Array
from gss.domain.camera import Camera
from gss.domain.errors import BadInput
from gss.pipeline.analysis.series import AttitudeSeries
from gss.pipeline.sheet.heads import Fitted, ReferenceErrors, ReferenceInput, reference_errors
from gss.pipeline.sheet.noise import TemporalNoise, temporal_noise
from gss.pipeline.sheet.pattern import PatternError, pattern_error
from gss.pipeline.sheet.rows import SheetFigure, SheetRow, axis_rows, counted_conditions, missing
from gss.pipeline.sheet.spatial import SpatialErrors, StarError, StarSightings, spatial_errors
from gss.pipeline.sheet.trials import END_OF_LIFE, ROBUSTNESS, Trials, acquisition_row, condition_row, tracking_row

BIAS = ("bias", "Bias", "mean rotation from the reference, compared with the mounting from ground alignment")
THERMAL = ("thermo-elastic", "Thermo-elastic error", "rotation from the reference, regressed on temperature")
FIELD = (
    "field-of-view",
    "Field-of-view spatial error",
    "slow part of the star residuals over the detector, as the attitude error that it causes; rms over the frames",
)
PIXEL = (
    "pixel",
    "Pixel spatial error",
    "part of the star residuals that is periodic in a pixel, and part that returns with the pixel, as attitude errors",
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
    """Data of one unit. ``series``: attitudes in order of time; ``residuals``: stars of the same frames, None
    without any. ``reference``: for the rows that need a second head. ``acquisition``, ``aged``, ``disturbed``:
    trials with a known truth."""

    camera: Camera
    series: AttitudeSeries
    residuals: StarSightings | None = None
    reference: ReferenceInput | None = None
    acquisition: Trials | None = None
    aged: tuple[Trials, ...] = ()
    disturbed: tuple[Trials, ...] = ()


@dataclass(frozen=True)
class PerformanceSheet:
    """All rows, and the analyses from which they were made, for drawings."""

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


def performance_sheet(given: SheetInput, rng: np.random.Generator) -> PerformanceSheet:
    """Compute every row. A row without data states what it needs."""
    spatial, pattern, problem = _spatial(given, rng)
    noise = temporal_noise(given.series, given.camera, rng)
    found, apart = _reference(given.reference, rng)
    rows = (
        _bias(found, given.reference, apart),
        _thermal(found, given.reference, apart),
        _field_row(spatial, given.camera, problem),
        _pixel_row(spatial, pattern, problem),
        _noise_row(noise),
        _aberration_row(found, given.reference, apart),
        _date_row(found, apart),
        acquisition_row(given.acquisition, given.series),
        tracking_row(given.series, given.camera),
        condition_row(
            END_OF_LIFE, given.aged, "a simulation of the aged unit, or the trend of several months of frames"
        ),
        condition_row(ROBUSTNESS, given.disturbed, "frames with the disturbance; a simulated unit has them"),
    )
    return PerformanceSheet(rows, spatial, noise, found, tuple(p for p in (problem, apart) if p))


def _spatial(given: SheetInput, rng: np.random.Generator) -> tuple[SpatialErrors | None, PatternError | None, str]:
    if given.residuals is None:
        return None, None, "identified stars with their residuals"
    try:
        spatial = spatial_errors(given.residuals, given.camera, rng)
    except BadInput as error:
        return None, None, f"{error.expected} (there are {error.got})"
    try:
        return spatial, pattern_error(given.residuals, spatial, rng), ""
    except BadInput:
        return spatial, None, ""


def _reference(given: ReferenceInput | None, rng: np.random.Generator) -> tuple[ReferenceErrors | None, str]:
    if given is None:
        return None, ""
    try:
        return reference_errors(given, rng), ""
    except BadInput as error:
        return None, str(error)


def _bias(found: ReferenceErrors | None, given: ReferenceInput | None, problem: str) -> SheetRow:
    if found is None or given is None:
        return missing(*BIAS, problem or "frames of a second head taken at the same times, or reference attitudes")
    if found.bias is None:
        return missing(*BIAS, "the mounting from ground alignment (quaternion camera from reference)")
    figures = axis_rows(found.bias.value, found.bias.low, found.bias.high, "rad")
    if found.drift is not None:
        figures += axis_rows(found.drift.value, found.drift.low, found.drift.high, "rad/d", "drift ")
    return SheetRow(*BIAS, _condition(found), found.pairs, figures)


def _thermal(found: ReferenceErrors | None, given: ReferenceInput | None, problem: str) -> SheetRow:
    if found is None or given is None:
        return missing(*THERMAL, problem or "frames of a second head, and telemetry of the temperature")
    if found.thermal is None:
        return missing(*THERMAL, "temperatures of the unit that vary by at least 2 K during the frames")
    return SheetRow(
        *THERMAL,
        f"{found.span_k:.1f} K around {found.middle_c:.1f} °C; linear",
        found.pairs,
        axis_rows(found.thermal.value, found.thermal.low, found.thermal.high, "rad/K"),
    )


def _condition(found: ReferenceErrors) -> str:
    return counted_conditions(
        [
            f"mean temperature {found.middle_c:.1f} °C" if found.span_k else "",
            f"rates up to {np.degrees(found.rate_rad_s):.3g}°/s",
        ]
    )


def _field_row(found: SpatialErrors | None, camera: Camera, problem: str) -> SheetRow:
    if found is None:
        return missing(*FIELD, problem)
    e = found.field
    star = _star("one star", found.field_star)
    text = (
        f"{found.sightings} stars; polynomial of degree {found.degree}, features wider than about "
        f"{camera.columns / found.degree:.0f} px; 1 px is {camera.pixel_rad / ARCSEC_RAD:.1f}″"
    )
    return SheetRow(*FIELD, text, found.frames, (*axis_rows(e.value_rad, e.low_rad, e.high_rad, "rad"), star))


def _pixel_row(found: SpatialErrors | None, pattern: PatternError | None, problem: str) -> SheetRow:
    if found is None:
        return missing(*PIXEL, problem)
    e = found.phase
    star = _star("one star, periodic", found.phase_star)
    figures = (*axis_rows(e.value_rad, e.low_rad, e.high_rad, "rad", "periodic "), star)
    if pattern is None:
        text = "fixed pattern not separated: too few stars return to the same pixels"
        return SheetRow(*PIXEL, text, found.frames, figures)
    fixed = axis_rows(pattern.value_rad, pattern.low_rad, pattern.high_rad, "rad", "fixed ")
    one = SheetFigure("one star, fixed", pattern.value_px, pattern.low_px, pattern.high_px, "px")
    text = f"{pattern.pairs} returns of {pattern.stars} stars; 'fixed' includes the periodic part"
    return SheetRow(*PIXEL, text, found.frames, (*figures, *fixed, one))


def _noise_row(found: TemporalNoise | None) -> SheetRow:
    if found is None:
        return missing(*NOISE, "at least 22 frames taken one after the other at equal intervals")
    moved = f"stars move {found.motion_px:.2g} px from frame to frame"
    text = moved if found.still else f"{moved}: includes the pixel spatial error"
    return SheetRow(*NOISE, text, found.frames, axis_rows(found.nea_rad, found.low_rad, found.high_rad, "rad"))


def _aberration_row(found: ReferenceErrors | None, given: ReferenceInput | None, problem: str) -> SheetRow:
    if found is None or given is None:
        return missing(*ABERRATION, problem or "a reference, and the velocity of the unit")
    if found.aberration is None:
        return missing(*ABERRATION, "the velocity of the unit, and directions in which its aberration differs by 1″")
    return SheetRow(
        *ABERRATION,
        "1 is the whole aberration, 0 a complete correction",
        found.pairs,
        (_single("remaining share", found.aberration, "1"),),
    )


def _date_row(found: ReferenceErrors | None, problem: str) -> SheetRow:
    if found is None:
        return missing(*DATE, problem or "frames of a second head, or a reference, at changing rates")
    if found.date_s is None:
        return missing(*DATE, "rates that change by at least 0.02°/s during the frames")
    text = f"rates up to {np.degrees(found.rate_rad_s):.3g}°/s; positive: measured later than stated"
    return SheetRow(*DATE, text, found.pairs, (_single("date error", found.date_s, "s"),))


def _single(name: str, fit: Fitted, unit: str) -> SheetFigure:
    values: list[Array] = [fit.value, fit.low, fit.high]
    value, low, high = (float(v[0]) for v in values)
    return SheetFigure(name, value, low, high, unit)


def _star(name: str, error: StarError) -> SheetFigure:
    return SheetFigure(name, error.value_px, error.low_px, error.high_px, "px")
