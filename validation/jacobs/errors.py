"""Errors of distances and positions caused by an inaccurate camera model and by TRIAD (Jacobs 1995 §6.1 and app. E.1)."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np

from gss.domain.angles import Array
from gss.domain.camera import Camera, Pinhole
from gss.domain.experiment import Cell, Curve, Experiment, Progress
from gss.domain.stars import StarTable
from gss.instruments.registry import shipped_camera
from gss.pipeline.attitude import triad
from gss.pipeline.chains.sunsat_parameters import CENTROID_ERROR_PX, default_parameters

FOCAL_MM, PITCH_MM = 25.0, (0.0065, 0.00625)
MEAN_PITCH_MM = float(np.sqrt(PITCH_MM[0] * PITCH_MM[1]))
CORNER_MM = np.array([2.44, 1.82])
# Separation of the pair in mm and the largest error of a position in pixels.
TABLE_E_1 = ((0.13, 46), (0.5, 12), (1.0, 6), (2.0, 3))


def jacobs_6_1(stars: StarTable, trials: int, seed: int, progress: Progress) -> Experiment:
    """Measure distances with a camera whose focal length or centre is off, and positions with displaced star images."""
    camera = Camera.from_optics(752, 582, *PITCH_MM, FOCAL_MM, Pinhole())
    pair = np.array([CORNER_MM, -CORNER_MM])
    focal_um = np.linspace(-40.0, 40.0, 9)
    by_focal = [1e3 * _error_rad(camera, _focal_off(camera, um), pair) for um in focal_um]
    sideways = np.array([[2.0, 1.5], [0.0, -1.5]])
    centre_mm = np.linspace(0.0, 0.65, 14)
    by_centre = [_error_rad(camera, _centre_off(camera, mm), sideways) / camera.pixel_rad for mm in centre_mm]
    close = [
        abs(_error_rad(camera, _focal_off(camera, 40.0), np.array([[u, 0.0], [u + 0.5, 0.0]]))) / camera.pixel_rad
        for u in (-0.25, 1.9)
    ]
    rows: list[tuple[Cell, ...]] = [
        ("Fig. 6-2: focal length 40 µm off, 0.5 mm apart at the centre, px", "a fraction", round(close[0], 3), None),
        ("Fig. 6-2: focal length 40 µm off, 0.5 mm apart at the edge, px", "smaller", round(close[1], 3), None),
        (
            "Fig. 6-3: focal length 25 µm off, opposite corners, mrad",
            0.23,
            round(1e3 * abs(_error_rad(camera, _focal_off(camera, 25.0), pair)), 3),
            None,
        ),
        (
            "Fig. 6-5: centre 0.3 mm off, 2 mm to the side, px",
            "about half",
            round(abs(_error_rad(camera, _centre_off(camera, 0.3), sideways)) / camera.pixel_rad, 2),
            None,
        ),
    ]
    parameters = default_parameters(shipped_camera("sunsat"))
    for separation_mm, paper_px in TABLE_E_1:
        formula_px = parameters.uncertain_reach_mm * CENTROID_ERROR_PX / separation_mm
        rows.append(
            (
                f"Table E-1: pair {separation_mm:g} mm apart, px",
                paper_px,
                round(formula_px, 2),
                round(_triad_error_px(separation_mm), 2),
            )
        )
    progress(1.0)
    return Experiment(
        "jacobs-6-1",
        "Errors by focal length, optical centre and TRIAD",
        "Jacobs 1995 §6.1, Figs. 6-2 to 6-5, and app. E.1, Table E-1",
        ("quantity", "paper", "ours", "from TRIAD with displaced star images"),
        tuple(rows),
        (
            "752 x 582 px of 6.5 x 6.25 µm, 25 mm, no distortion; error: true minus measured separation of two stars",
            "Table E-1: both star images displaced by half a pixel in eight directions each; the pair lies in a corner and "
            "points to the centre, the other star is in the opposite corner; ours is eq. E.26 as the chain computes it",
        ),
        seed,
        (
            "The publication states no values for the curves in its figures. The table contains the values stated in its text.",
            "Eq. E.26 is an upper bound. TRIAD maps the first star exactly, so the displacement of this star reduces the error "
            "in the opposite corner: the largest error is below the bound by up to half a pixel. For the closest pair the rotation "
            "is 3°, where the linear formula is 0.3 % too small.",
        ),
        (
            Curve(
                "Separation error", "error of the focal length, µm", "error, mrad", _floats(focal_um), tuple(by_focal)
            ),
            Curve("Separation error", "error of the centre, mm", "error, px", _floats(centre_mm), tuple(by_centre)),
        ),
    )


def _floats(values: Array) -> tuple[float, ...]:
    return tuple(float(v) for v in values)


def _focal_off(camera: Camera, error_um: float) -> Camera:
    """Return the camera with an estimated focal length that is too short by ``error_um`` (eq. 6.2)."""
    return camera.with_focal_scaled(1.0 - 1e-3 * error_um / FOCAL_MM)


def _centre_off(camera: Camera, error_mm: float) -> Camera:
    """Return the camera with an estimated centre that is ``error_mm`` off along +u."""
    return replace(camera, centre_col_px=camera.centre_col_px - error_mm / PITCH_MM[0])


def _error_rad(true: Camera, estimated: Camera, positions_mm: Array) -> float:
    """Return the true minus the measured separation of two star images at ``positions_mm`` from the true centre (eq. 6.1)."""
    pixels = positions_mm / np.array(PITCH_MM) + np.array([true.centre_col_px, true.centre_row_px])
    return _separation_rad(true.unproject(pixels)) - _separation_rad(estimated.unproject(pixels))


def _separation_rad(pair: Array) -> float:
    return float(np.arctan2(np.linalg.norm(np.cross(pair[0], pair[1])), pair[0] @ pair[1]))


def _triad_error_px(separation_mm: float) -> float:
    """Return the largest error of the expected position of a star in the opposite corner, mean pixels."""
    inward = -CORNER_MM / np.linalg.norm(CORNER_MM)
    positions_mm = np.array([CORNER_MM, CORNER_MM + separation_mm * inward])
    true, star = _directions(positions_mm), _directions(-CORNER_MM[None])[0]
    angles = np.radians(np.arange(0.0, 360.0, 45.0)) + np.arctan2(inward[1], inward[0])
    shifts = CENTROID_ERROR_PX * MEAN_PITCH_MM * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    worst_mm = 0.0
    for (first, second), order in product(product(shifts, shifts), ([0, 1], [1, 0])):
        observed = _directions(positions_mm + np.array([first, second]))
        expected = triad(observed[order], true[order]) @ star
        worst_mm = max(worst_mm, float(np.linalg.norm(FOCAL_MM * expected[:2] / expected[2] + CORNER_MM)))
    return worst_mm / MEAN_PITCH_MM


def _directions(positions_mm: Array) -> Array:
    v = np.column_stack([positions_mm, np.full(len(positions_mm), FOCAL_MM)])
    return np.asarray(v / np.linalg.norm(v, axis=1, keepdims=True))
