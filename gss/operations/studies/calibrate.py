"""Calibrates a camera from shots, for the server and the command line."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gss.device.table_use import calibrated, calibration_values
from gss.domain.camera_profile import CameraProfile
from gss.domain.errors import BadInput
from gss.domain.json_object import JsonObject
from gss.domain.words import counted
from gss.operations.frames.solve import Solver
from gss.operations.studies import calibration_report as report
from gss.operations.studies.night_frames import ProgressCallback, Shot, SolvedFrame, solve_shots, stack
from gss.pipeline.calibration.apply import calibrated_profile, detector_figures
from gss.pipeline.calibration.bundle import Prior
from gss.pipeline.calibration.dark import DarkCalibration, Response, calibrate_dark, pixel_response
from gss.pipeline.calibration.focus import focus_advice
from gss.pipeline.calibration.lens_models import GEOMETRY, LENS_MODELS
from gss.pipeline.calibration.photometric import calibrate_photometry
from gss.pipeline.calibration.photon_transfer import FlatPair, photon_transfer
from gss.pipeline.calibration.psf_field import psf_over_field
from gss.pipeline.calibration.result import CameraCalibration
from gss.pipeline.calibration.self_calibrate import calibrate_camera
from gss.pipeline.calibration.sightings import FrameStars

PSF_SHOTS = 8
"""Number of shots whose star widths are measured. More shots would take longer and would not improve the result."""


@dataclass(frozen=True)
class CalibrationInput:
    """A calibration before it is stored. ``values``: values of the sensor's table, empty for a camera without a
    profile."""

    kind: str
    values: JsonObject
    result: JsonObject


def check_models(models: Sequence[str]) -> None:
    """Raise BadInput for an unknown lens model."""
    unknown = sorted(set(models) - set(LENS_MODELS))
    if unknown:
        raise BadInput("unknown lens model", expected=" | ".join(LENS_MODELS), got=", ".join(unknown))


def from_stars(
    solver: Solver,
    shots: Sequence[Shot],
    profile: CameraProfile | None,
    progress: ProgressCallback,
    *,
    models: Sequence[str] = (),
    fov_rad: float | None = None,
    photometry: bool = True,
    psf: bool = True,
    priors: Mapping[str, Prior] | None = None,
) -> CalibrationInput:
    """Calibrate geometry, magnitudes and spot widths from frames of stars. ``profile``: None for an unknown
    camera, which is solved blind; ``priors``: priors from bench calibrations."""
    check_models(models)
    solved = _first_solved(solver, shots, profile, fov_rad, lambda share, text: progress(0.5 * share, text))
    focal_mm = profile.focal_mm if profile else None

    def fit(stars: Sequence[FrameStars], begin: float) -> CameraCalibration:
        progress(begin, "Fitting the camera")
        lenses = tuple(models) or tuple(LENS_MODELS)
        parameter_names = {*GEOMETRY, *(n for lens in lenses for n in LENS_MODELS[lens])}
        return calibrate_camera(
            stars,
            solved.start,
            models=lenses,
            focal_mm=focal_mm,
            priors={n: p for n, p in (priors or {}).items() if n in parameter_names},
            progress=lambda share: progress(begin + 0.1 * share, "Fitting the camera"),
        )

    geometry = fit(solved.stars, 0.5)
    # If the initial geometry is wrong, stars at the edge are not matched. Therefore the shots are solved again with the
    # fitted geometry.
    solved_again = solve_shots(
        solver, shots, profile, fov_rad, lambda share, text: progress(0.6 + 0.15 * share, text), camera=geometry.camera
    )
    if _matched_count(solved_again) > _matched_count(solved):
        solved = replace(solved_again, start=solved.start)
        geometry = fit(solved.stars, 0.75)
    result: JsonObject = {"geometry": report.geometry(geometry), "account": solved.account}
    light = None
    gain_e_per_dn = profile.sensor.gain_e_per_dn if profile else math.nan
    if photometry:
        progress(0.86, "Fitting the magnitudes")
        try:
            light = calibrate_photometry(solved.stars, geometry.camera, gain_e_per_dn=gain_e_per_dn)
            result["photometry"] = report.photometry(light)
        except BadInput as error:  # store the geometry even if the photometry fails
            result["photometry_problem"] = str(error)
    if psf:
        progress(0.92, "Measuring the spots")
        full_dn = float(profile.sensor.saturation_dn) if profile else float((1 << shots[0].bits) - 1)
        images = [solver.cleaned(s.pixels(), profile, s.exposure_s)[0] for s in solved.shots[:PSF_SHOTS]]
        e_per_dn = profile.sensor.gain_e_per_dn if profile else 0.0
        try:
            spot_width = psf_over_field(images, geometry.camera, e_per_dn=e_per_dn, saturation_dn=full_dn)
            result["psf"] = report.psf(spot_width, focus_advice(spot_width.centre_sigma_px))
        except BadInput as error:
            result["psf_problem"] = str(error)
    result["warnings"] = report.warnings(geometry, light)
    values = dict(calibration_values(calibrated_profile(profile, geometry, light))) if profile else {}
    return CalibrationInput("stars", values, result)


def _first_solved(
    solver: Solver,
    shots: Sequence[Shot],
    profile: CameraProfile | None,
    fov_rad: float | None,
    progress: ProgressCallback,
) -> SolvedFrame:
    """Solve the shots with the documented camera. If fewer than half are solved, the documented lens is probably wrong.
    In this case also solve the shots from the width of the field of view alone. Return the solution with more matched
    stars."""
    if profile is None:
        return solve_shots(solver, shots, None, fov_rad, progress)
    problem: BadInput | None = None
    with_profile: SolvedFrame | None = None
    try:
        with_profile = solve_shots(solver, shots, profile, None, lambda share, text: progress(0.5 * share, text))
        if 2 * len(with_profile.shots) >= len(shots):
            return with_profile
    except BadInput as error:
        problem = error
    try:
        width = profile.camera.fov_rad[0]
        blind = solve_shots(solver, shots, None, width, lambda share, text: progress(0.5 + 0.5 * share, text))
    except BadInput:
        if with_profile is None and problem is not None:
            raise problem from None
        blind = None
    if with_profile is not None and (blind is None or _matched_count(with_profile) >= _matched_count(blind)):
        return with_profile
    assert blind is not None  # noqa: S101 - otherwise the problem was raised above
    return replace(blind, start=profile.camera)


def _matched_count(solved: SolvedFrame) -> int:
    return sum(len(stars.hip) for stars in solved.stars)


def from_darks(
    darks: Sequence[Shot],
    flat_pairs: Sequence[Sequence[Shot]],
    profile: CameraProfile,
    progress: ProgressCallback,
    keep: Callable[[DarkCalibration, Response | None], JsonObject] | None = None,
) -> CalibrationInput:
    """Determine pattern, hot and dead pixels, noise and gain from dark frames of one exposure and pairs of flat fields.
    ``keep``: function that stores the dark frame for reruns and returns its entry for the result. Raises BadInput for
    different exposures."""
    progress(0.0, counted(len(darks), "dark frame"))
    exposures = {shot.exposure_s for shot in darks}
    if len(exposures) > 1:
        exposure_list = ", ".join(str(e) for e in sorted(exposures, key=str))
        raise BadInput("the dark frames have different exposures", expected="one exposure", got=exposure_list)
    exposure_s = exposures.pop() or profile.sensor.exposure_s
    dark = calibrate_dark(stack(darks, profile), exposure_s)
    result: JsonObject = {"dark": report.dark(dark)}
    parts: list[Any] = [dark]
    curve, even = None, None
    if flat_pairs:
        progress(0.5, f"{len(flat_pairs)} pairs of flat fields")
        flats = [stack(pair, profile).astype(np.float32) for pair in flat_pairs]
        # The dark frames contain dark current. They give the level without light, but not bias and read noise.
        curve = photon_transfer(
            [FlatPair(f[0], f[1]) for f in flats],
            saturation_dn=float(profile.sensor.saturation_dn),
            dark_dn=dark.typical_dn,
        )
        even = pixel_response(_same_level(np.concatenate(flats) - dark.median_dn), 0.0)
        result |= {"photon_transfer": report.photon_transfer(curve), "response": report.response(even)}
        parts += [curve, even]
    bias_dn = curve.bias_dn if curve is not None and math.isfinite(curve.bias_dn) else profile.sensor.bias_dn
    gain = curve.gain_e_per_dn if curve is not None else profile.sensor.gain_e_per_dn
    figures = detector_figures(curve, dark.dark_e_s(bias_dn, gain))
    values = dict(calibration_values(calibrated_profile(profile, detector=figures)))
    calibrated(profile, values)
    if keep is not None:
        result["dark_frame"] = keep(dark, even)
    result["warnings"] = report.warnings(*parts)
    return CalibrationInput("detector", values, result)


def _same_level(flats: NDArray[np.float32]) -> NDArray[np.float32]:
    """Scale frames to the same median level, so that they differ only by the response of individual pixels."""
    levels = np.median(flats.reshape(len(flats), -1), axis=1)
    return np.asarray(flats * (np.median(levels) / np.maximum(levels, 1e-6))[:, None, None], np.float32)
