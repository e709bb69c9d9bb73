"""Bench calibrations from dots, pairs of stars, checkerboards, dark currents and focus runs. Each method determines one
part of a camera with its uncertainty. The results of PRIOR_KINDS can be priors of a calibration from stars."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from gss.device.table_use import calibration_values
from gss.domain.camera import RadialTilt
from gss.domain.camera_profile import CameraProfile
from gss.domain.errors import BadInput
from gss.domain.json_object import JsonObject
from gss.operations.frames.solve import Solver
from gss.operations.studies import calibration_report as report
from gss.operations.studies.calibrate import CalibrationInput
from gss.operations.studies.night_frames import ProgressCallback, Shot, solve_shots
from gss.pipeline.calibration.apply import calibrated_profile
from gss.pipeline.calibration.bundle import Prior
from gss.pipeline.calibration.checkerboard import calibrate_checkerboard
from gss.pipeline.calibration.dark_temperature import dark_against_temperature
from gss.pipeline.calibration.dots import detector_tilt, optical_centre
from gss.pipeline.calibration.focal_pairs import focal_from_pairs
from gss.pipeline.calibration.focus import best_focus, focus_advice
from gss.pipeline.calibration.light_circle import principal_point
from gss.pipeline.calibration.plain_values import as_record
from gss.pipeline.calibration.psf_field import psf_over_field
from gss.pipeline.calibration.radial import radial_polynomial

KINDS = (
    "bench-centre",
    "bench-second-lens",
    "bench-tilt",
    "bench-focal",
    "bench-radial",
    "bench-checkerboard",
    "bench-dark-law",
    "bench-focus",
)
PRIOR_KINDS = ("bench-centre", "bench-second-lens", "bench-tilt", "bench-focal", "bench-checkerboard")
"""Kinds that provide a prior for the camera's geometry."""
Rows = Sequence[Sequence[float]]
MAX_ROWS = 5000
MAX_POINTS = 2000
MIN_SETTINGS = 4
ZERO_C_K = 273.15
STEADY_SIGMA_PX = 0.02
"""Minimum σ, in px, of a centre or focal length measured on a bench. It allows for the mechanical play of clamps and
tables."""


def centre(dots_px: Rows) -> CalibrationInput:
    """Determine the optical centre from positions (col, row) of one dot while the camera rotates about its axis (Jacobs
    1995 §6.2.1)."""
    dots = table(dots_px, 2, "positions of a dot: col, row")
    result = optical_centre(dots)
    content = dict(as_record(replace(result, warnings=()))) | {"dots_px": as_record(dots)}
    return _input_of("bench-centre", {"centre": content}, result.warnings)


def second_lens(shots: Sequence[Shot], profile: CameraProfile | None) -> CalibrationInput:
    """Determine the principal point from pictures through a second lens that faces the camera (Erlank 2013 §5.4).
    ``profile``: camera whose dark columns are removed and whose size is checked, None for any camera."""
    pictures = [s.pixels() for s in shots]
    if profile is not None:
        camera, dark_columns = profile.camera, profile.sensor.dark_columns
        pictures = [dark_columns.split(picture, camera.columns)[0] for picture in pictures]
        for shot, picture in zip(shots, pictures, strict=True):
            if picture.shape != (camera.rows, camera.columns):
                raise BadInput(
                    f"{shot.name} is not of this camera",
                    expected=f"{camera.columns} x {camera.rows} px",
                    got=f"{picture.shape[1]} x {picture.shape[0]} px",
                )
    result = principal_point([np.asarray(picture, float) for picture in pictures])
    content = dict(as_record(replace(result, warnings=())))
    content |= {
        "pictures": [s.name for s in shots],
        "circles": [dict(as_record(c)) | {"sigma_px": c.sigma_px} for c in result.circles],
    }
    return _input_of("bench-second-lens", {"second_lens": content}, result.warnings)


def tilt(pairs_px: Rows, profile: CameraProfile) -> CalibrationInput:
    """Determine the detector's tilt from the positions (col, row, col, row) of two dots, the first near the centre and
    the second far from it (eq. 6.15)."""
    pairs = table(pairs_px, 4, "positions of two dots: inner col, row, outer col, row")
    result = detector_tilt(pairs[:, :2], pairs[:, 2:], profile.camera, profile.focal_mm)
    return _input_of("bench-tilt", {"tilt": dict(as_record(replace(result, warnings=())))}, result.warnings)


def dark_law(rows: Rows) -> CalibrationInput:
    """Determine the dark current as a function of temperature from rows of °C and electrons per second (eq. H.2)."""
    points = table(rows, 2, "temperature in °C, dark current in e⁻/s")
    law = dark_against_temperature(points[:, 0] + ZERO_C_K, points[:, 1])
    content = dict(as_record(replace(law, warnings=())))
    content |= {"temperature_c": as_record(points[:, 0]), "dark_e_s": as_record(points[:, 1])}
    return _input_of("bench-dark-law", {"dark_law": content}, law.warnings)


def focal(
    solver: Solver, shots: Sequence[Shot], profile: CameraProfile, progress: ProgressCallback, radius_px: float | None
) -> CalibrationInput:
    """Determine the focal length from pairs of stars near the centre (eq. 6.4–6.6, Erlank 2013 eq. 5.4.1)."""
    solved = solve_shots(solver, shots, profile, None, lambda share, text: progress(0.9 * share, text))
    result = focal_from_pairs(solved.stars, profile.camera, radius_px=radius_px)
    pick = np.linspace(0, len(result.values_px) - 1, min(len(result.values_px), MAX_POINTS)).astype(int)
    thinned = replace(result, warnings=(), values_px=result.values_px[pick], radius_px=result.radius_px[pick])
    content = dict(as_record(thinned)) | {
        "documented_px": float(np.sqrt(profile.camera.focal_col_px * profile.camera.focal_row_px))
    }
    return _input_of("bench-focal", {"focal": content, "account": solved.account}, result.warnings)


def radial(
    solver: Solver, shots: Sequence[Shot], profile: CameraProfile, progress: ProgressCallback, order: int
) -> CalibrationInput:
    """Determine the polynomial of lens aberration from the distances of all stars to a star near the centre (eq.
    6.16–6.17)."""
    if not 1 <= order <= 4:
        raise BadInput("unsupported order of the polynomial", expected="1 to 4", got=str(order))
    solved = solve_shots(solver, shots, profile, None, lambda share, text: progress(0.9 * share, text))
    polynomial = radial_polynomial(solved.stars, profile.camera, profile.focal_mm, order)
    pick = np.linspace(0, len(polynomial.r_mm) - 1, min(len(polynomial.r_mm), MAX_POINTS)).astype(int)
    thinned = {n: getattr(polynomial, n)[pick] for n in ("r_mm", "delta_mm", "residual_mm", "used")}
    content = dict(as_record(replace(polynomial, warnings=(), **thinned)))
    values: JsonObject = {}
    lens = profile.camera.distortion
    if isinstance(lens, RadialTilt):
        fitted = replace(lens, radial=tuple(float(k) for k in polynomial.coefficients))
        values = dict(calibration_values(calibrated_profile(profile, replace(profile.camera, distortion=fitted))))
    return CalibrationInput(
        "bench-radial", values, {"radial": content, "account": solved.account, "warnings": report.warnings(polynomial)}
    )


def checkerboard(
    shots: Sequence[Shot], profile: CameraProfile | None, corners: tuple[int, int], square_mm: float, fit_k3: bool
) -> CalibrationInput:
    """Determine focal length, centre and Brown's coefficients from pictures of a checkerboard (Erlank 2013 §5.4)."""
    result = calibrate_checkerboard([s.pixels() for s in shots], corners, square_mm, fit_k3=fit_k3)
    keep = {"corners_px": (), "residual_px": (), "warnings": ()}
    content = {n: as_record(v) for n, v in vars(result).items() if n not in keep}
    pick = np.linspace(0, len(result.corners_px) - 1, min(len(result.corners_px), MAX_POINTS)).astype(int)
    content |= {"corners_px": as_record(result.corners_px[pick]), "residual_px": as_record(result.residual_px[pick])}
    content["pictures"] = [s.name for s in shots]
    values = dict(calibration_values(calibrated_profile(profile, result.camera))) if profile else {}
    return CalibrationInput(
        "bench-checkerboard",
        values,
        {"checkerboard": content, "camera": content["camera"], "warnings": report.warnings(result)},
    )


def focus(
    positions: Sequence[float],
    shots: Sequence[Shot],
    profile: CameraProfile,
    progress: ProgressCallback,
    wished_sigma_px: float,
) -> CalibrationInput:
    """Determine the best focus setting from one or more pictures of stars at each of several settings."""
    if len(positions) != len(shots):
        raise BadInput(
            "each image of a focus run needs its setting", expected=f"{len(shots)} settings", got=str(len(positions))
        )
    by_setting: dict[float, list[Shot]] = {}
    for position, shot in zip(positions, shots, strict=True):
        by_setting.setdefault(float(position), []).append(shot)
    settings, widths, skipped = [], [], []
    for k, (setting, pictures) in enumerate(sorted(by_setting.items())):
        progress(k / len(by_setting), f"Setting {setting:g}, {k + 1} of {len(by_setting)}")
        try:
            field = psf_over_field(
                [picture.pixels() for picture in pictures],
                profile.camera,
                e_per_dn=profile.sensor.gain_e_per_dn,
                saturation_dn=float(profile.sensor.saturation_dn),
            )
        except BadInput as error:
            names = ", ".join(picture.name for picture in pictures)
            skipped.append({"name": f"setting {setting:g}: {names}", "used": False, "reason": str(error)})
            continue
        settings.append(setting)
        widths.append(float(field.centre_sigma_px))
    if skipped and len(settings) < MIN_SETTINGS:
        raise BadInput(
            "star width measured at too few settings",
            expected=f"{MIN_SETTINGS} settings",
            got=f"{len(settings)}; {skipped[0]['name']}: {skipped[0]['reason']}",
            hint="take several images at each setting, of a field with bright stars",
        )
    return _focus_result(settings, widths, wished_sigma_px, skipped)


def focus_of_widths(rows: Rows, wished_sigma_px: float) -> CalibrationInput:
    """Determine the best focus setting from rows of setting and measured star width σ in px."""
    points = table(rows, 2, "setting of the lens, σ of the stars in px")
    return _focus_result(points[:, 0].tolist(), points[:, 1].tolist(), wished_sigma_px, [])


def _focus_result(
    settings: list[float], widths: list[float], wished_px: float, skipped: list[JsonObject]
) -> CalibrationInput:
    if not wished_px > 0:
        raise BadInput("invalid star width", expected="σ above 0 px", got=f"{wished_px:g} px")
    best = best_focus(np.array(settings), np.array(widths), wished_px)
    advice = focus_advice(max(best.smallest_sigma_px, 0.05))
    content = dict(as_record(best)) | {"positions": settings, "sigma_px": widths, "advice": as_record(advice)}
    return _input_of("bench-focus", {"focus_run": content, "account": skipped}, ())


def _input_of(kind: str, result: JsonObject, warnings: Sequence[Any]) -> CalibrationInput:
    return CalibrationInput(kind, {}, result | {"warnings": [as_record(w) for w in warnings]})


def table(rows: Rows, columns: int, title: str) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Return rows as (n, columns) numbers. Raises BadInput with the number of the first invalid row."""
    if not 1 <= len(rows) <= MAX_ROWS:
        raise BadInput(f"invalid data: not {title}", expected=f"1 to {MAX_ROWS} rows", got=str(len(rows)))
    for k, row in enumerate(rows):
        if len(row) != columns or not np.isfinite(np.asarray(row, float)).all():
            got = ", ".join(f"{v:g}" for v in row)
            raise BadInput(f"invalid row {k + 1}: not {title}", expected=f"{columns} numbers", got=got or "nothing")
    return np.asarray(rows, float)


# --- priors from the bench ----------------------------------------------------------------------------------------


def priors_of(results: Sequence[tuple[str, Mapping[str, Any]]]) -> dict[str, Prior]:
    """Return the priors for a camera from bench results (kind, result). A later result replaces an earlier result for
    the same value. Raises BadInput for a kind that is not in PRIOR_KINDS."""
    out: dict[str, Prior] = {}
    for kind, result in results:
        if kind in ("bench-centre", "bench-second-lens"):
            centre = result["centre" if kind == "bench-centre" else "second_lens"]
            sigma = max(float(centre["sigma_px"] or 0.0), STEADY_SIGMA_PX)
            out |= {"centre_col_px": Prior(centre["col_px"], sigma), "centre_row_px": Prior(centre["row_px"], sigma)}
        elif kind == "bench-tilt":
            tilt = result["tilt"]
            size, turn = float(tilt["tilt_max_rad"]), float(tilt["tilt_direction_rad"])
            sigma = max(float(np.hypot(tilt["sigma_rad"][0], size * tilt["sigma_rad"][1])), 1e-5)
            out["tilt_col_rad"] = Prior(size * float(np.cos(turn)), sigma)
            out["tilt_row_rad"] = Prior(size * float(np.sin(turn)), sigma)
        elif kind == "bench-focal":
            focal = result["focal"]
            spread = focal["sigma_px"] if focal["sigma_px"] is not None else 0.002 * focal["focal_px"]
            out["focal_px"] = Prior(focal["focal_px"], max(spread, STEADY_SIGMA_PX))
        elif kind == "bench-checkerboard":
            out |= _of_checkerboard(result["checkerboard"])
        else:
            raise BadInput(
                "this calibration cannot be used as a prior",
                expected=" | ".join(PRIOR_KINDS),
                got=kind,
            )
    return out


def _of_checkerboard(content: Mapping[str, Any]) -> dict[str, Prior]:
    value = dict(zip(content["names"], content["values"], strict=True))
    sigma = dict(zip(content["names"], content["sigma"], strict=True))
    focal_px = float(np.sqrt(value["focal_col_px"] * value["focal_row_px"]))
    # The camera was focused on the board and not on stars, so the focal length for stars is uncertain by half a percent,
    # which is more than the σ of the measurement.
    out = {"focal_px": Prior(focal_px, max(sigma["focal_col_px"], 0.005 * focal_px))}
    for name in ("centre_col_px", "centre_row_px"):
        out[name] = Prior(value[name], max(sigma[name], STEADY_SIGMA_PX))
    return out
