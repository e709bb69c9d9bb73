"""Measures the camera of a set of photographs: geometry, magnitudes, star width, detection limit, and level and noise
of the sky."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from gss.domain.angles import Array
from gss.domain.camera import Camera
from gss.domain.errors import BadInput
from gss.operations.frames.solve import Solver, SolveRequest
from gss.operations.studies.analyse import detected_stars
from gss.operations.studies.calibrate import PSF_SHOTS
from gss.operations.studies.night_frames import ProgressCallback, matched_stars, request_of
from gss.operations.studies.photographs import SolvedPhotograph, SortedPhotographs, without
from gss.pipeline.analysis.sensitivity import Sensitivity, detection_limit
from gss.pipeline.calibration.photometric import PhotometricCalibration, calibrate_photometry
from gss.pipeline.calibration.psf_field import PsfField, psf_over_field
from gss.pipeline.calibration.result import CameraCalibration
from gss.pipeline.calibration.self_calibrate import calibrate_camera
from gss.pipeline.calibration.sky_figures import SkyFigures, sky_figures

LENSES = ("pinhole", "brown-2", "brown-4", "brown-5")
SAME_FIELD = 0.1
"""Maximum difference between the pointings of photographs of the same field, as a share of the field of view."""
SAME_ROLL_RAD = float(np.radians(10.0))
BELOW_MATCHED_MAG = 1.0
WIDTH_STARS = 200
COLOUR_MODES = ("RGB", "RGBA", "P", "CMYK", "YCbCr")
T = TypeVar("T")


@dataclass(frozen=True)
class PhotographCamera:
    """Measured properties of the camera. ``same_field``: True if all photographs show one field and therefore count as
    one measurement of the geometry. ``missing``: quantities that could not be measured, with the reason. ``linear``:
    False if the pixel values are not proportional to the light."""

    photographs: SortedPhotographs
    geometry: CameraCalibration
    light: PhotometricCalibration | None
    spots: PsfField | None
    limit: Sensitivity | None
    sky: SkyFigures
    same_field: bool
    linear: bool
    missing: tuple[str, ...]


def measure(solver: Solver, photographs: SortedPhotographs, progress: ProgressCallback) -> PhotographCamera:
    """Calibrate one camera from all photographs together. Raises BadInput if fewer than three photographs can be
    used."""
    start_camera = max(photographs.used, key=lambda s: len(s.stars)).result.camera
    geometry = _calibrated(photographs, start_camera, lambda share: progress(0.2 * share, "Fitting the camera"))
    solved_again = _solved_again(solver, photographs, geometry.camera, lambda s, text: progress(0.2 + 0.4 * s, text))
    if sum(len(s.stars) for s in solved_again.used) > sum(len(s.stars) for s in photographs.used):
        photographs = solved_again
        geometry = _calibrated(
            photographs, start_camera, lambda share: progress(0.6 + 0.2 * share, "Fitting the camera")
        )
    excluded = {f.name: f.excluded for f in geometry.frames if f.excluded}
    if excluded:
        photographs = without(photographs, excluded)
    progress(0.82, "Fitting the magnitudes")
    missing: list[str] = []
    stars = [s.stars for s in photographs.used]
    light = _measured_or_none("zero point", missing, lambda: calibrate_photometry(stars, geometry.camera))
    progress(0.88, "Measuring the stars' width")
    width_photographs = photographs.used[: _shots_for_width(photographs)]
    full_dn = min(s.stars.saturation_dn for s in width_photographs)
    spots = _measured_or_none(
        "width of a star",
        missing,
        lambda: psf_over_field(
            [s.photograph.shot.pixels() for s in width_photographs], geometry.camera, saturation_dn=full_dn
        ),
    )
    progress(0.94, "Measuring limit and noise")
    limit = _measured_or_none("limiting magnitude", missing, lambda: _limit(solver, photographs))
    files = [s.photograph.file for s in photographs.used]
    linear = not any(f.get("format") == "JPEG" or f.get("mode") in COLOUR_MODES for f in files)
    sky = sky_figures([s.photograph.shot.pixels() for s in photographs.used], linear=linear)
    same_field = is_one_field(photographs.used)
    return PhotographCamera(photographs, geometry, light, spots, limit, sky, same_field, linear, tuple(missing))


def _shots_for_width(photographs: SortedPhotographs) -> int:
    """Return the number of photographs needed to measure the star width. It is limited, because each star takes 0.05
    s."""
    return min(PSF_SHOTS, math.ceil(WIDTH_STARS / float(np.median([len(s.stars) for s in photographs.used]))))


def is_one_field(photographs: tuple[SolvedPhotograph, ...]) -> bool:
    """True if all photographs show the same field with the same roll."""
    first = _attitude(photographs[0])
    width_rad = photographs[0].result.camera.fov_rad[0]
    for rotation in (_attitude(s) @ first.T for s in photographs[1:]):
        angle_rad = float(np.arctan2(np.hypot(rotation[0, 2], rotation[1, 2]), rotation[2, 2]))
        roll = abs(float(np.arctan2(rotation[1, 0] - rotation[0, 1], rotation[0, 0] + rotation[1, 1])))
        if angle_rad > SAME_FIELD * width_rad or roll > SAME_ROLL_RAD:
            return False
    return True


def _attitude(solved: SolvedPhotograph) -> Array:
    assert solved.result.attitude is not None  # noqa: S101 - only solved photographs have stars
    return solved.result.attitude.cam_from_icrs


def _calibrated(photographs: SortedPhotographs, start: Camera, progress: Callable[[float], None]) -> CameraCalibration:
    return calibrate_camera([s.stars for s in photographs.used], start, models=LENSES, progress=progress)


def _solved_again(
    solver: Solver, photographs: SortedPhotographs, camera: Camera, progress: ProgressCallback
) -> SortedPhotographs:
    """Solve the photographs again with the calibrated geometry, which identifies more stars near the edge. A photograph
    without a new solution keeps its previous solution."""
    used = []
    for k, solved in enumerate(photographs.used):
        shot = solved.photograph.shot
        progress(k / len(photographs.used), f"{solved.name} with the calibrated camera")
        pixels = shot.pixels()
        request: SolveRequest = request_of(shot, None, None, "reference", camera)
        result = solver.solve(pixels, request)
        stars = matched_stars(solver, shot, pixels, result, None)
        used.append(solved if stars is None else replace(solved, result=result, stars=stars))
    return replace(photographs, used=tuple(used))


def _limit(solver: Solver, photographs: SortedPhotographs) -> Sensitivity:
    faintest = max(float(s.stars.v_mag.max()) for s in photographs.used) + BELOW_MATCHED_MAG
    detections = [detected_stars(s.result, solver, s.photograph.shot, faintest) for s in photographs.used]
    return detection_limit(np.concatenate([v for v, _ in detections]), np.concatenate([hit for _, hit in detections]))


def _measured_or_none(quantity: str, missing: list[str], make: Callable[[], T]) -> T | None:
    """Return a measurement. If the photographs are not sufficient, add the reason to ``missing`` and return None."""
    try:
        return make()
    except BadInput as error:
        missing.append(f"{quantity}: {error.message}")
        return None
