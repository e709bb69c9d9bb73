"""Compilation of the solver's loops before a frame needs them.

The loops are compiled at their first use and cached on disk. The compilation takes more than a minute of processor
time, once per installation. Solving small test frames with all methods that the chains use compiles all loops.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from gss.domain.angles import lengths
from gss.domain.camera import Camera
from gss.domain.camera_profile import CameraProfile
from gss.domain.errors import GssError
from gss.domain.frames import cam_from_icrs
from gss.domain.results import Outcome
from gss.operations.frames.rendered_image import RenderRequest, draw
from gss.operations.frames.solve import Solver, SolveRequest
from gss.pipeline.identify.baselines import baselines
from gss.pipeline.identify.focal_census import focal_objection
from gss.pipeline.identify.n_vertex import consistent_names
from gss.pipeline.identify.near import BoundedPrior
from gss.pipeline.identify.neighbour_pattern import PairHypotheses, PatternSpots, pattern_stars, supporters
from gss.pipeline.identify.soundness import is_handed
from gss.pipeline.kernels import kernels
from gss.pipeline.regions import find_blobs
from gss.pipeline.track.predictional import predictional_fit
from gss.skytables.pairs import distance_table_of_units
from gss.skytables.sin2 import sin2_directory

EPOCH_JYEAR = 2026.5
POINTING = cam_from_icrs(math.radians(84.0), math.radians(-2.0), math.radians(30.0))
PRIOR_RADIUS_RAD = math.radians(5.0)
TRAIL_PX = 8.0
Report = Callable[[int, int, str], None]
"""Called with the number of completed cases, the total number, and the name of the next case."""


@dataclass(frozen=True)
class CompileCase:
    """One method of solving the test frame. ``dtype``: type of the pixels; ``trailed``: the camera turns."""

    name: str
    request: SolveRequest
    dtype: type[np.generic] = np.uint8
    trailed: bool = False


def _cases(profile: CameraProfile) -> list[CompileCase]:
    """Return all cases that need different loops, or loops for different types."""
    request = SolveRequest(profile=profile.name, epoch_jyear=EPOCH_JYEAR, fast=True)
    cases = [
        CompileCase("lost in space", request),
        CompileCase("with a prior attitude", replace(request, hint=BoundedPrior(POINTING, PRIOR_RADIUS_RAD))),
        CompileCase("16-bit pixels", request, np.uint16),
        CompileCase("pixels of other types", request, np.float32),
        CompileCase("trailed stars", replace(request, exposure_s=profile.sensor.exposure_s), trailed=True),
    ]
    return (
        [*cases, CompileCase("the sensor's own chain", replace(request, chain=profile.chain))]
        if profile.chain
        else cases
    )


def compile_ahead(solver: Solver, profile: CameraProfile, report: Report) -> None:
    """Compile the loops by solving test frames of the camera ``profile``.

    Raises BadInput if numba is not installed, GssError if a frame is not solved.
    """
    still = RenderRequest(POINTING, epoch_jyear=EPOCH_JYEAR)
    rate_rad_s = TRAIL_PX * profile.camera.pixel_rad / profile.sensor.exposure_s
    pixels, trailed = (
        draw(profile, request).pixels for request in (still, replace(still, rate_rad_s=(rate_rad_s, 0.0, 0.0)))
    )
    cases = _cases(profile)
    for k, case in enumerate(cases):
        report(k, len(cases), case.name)
        result = solver.solve((trailed if case.trailed else pixels).astype(case.dtype), case.request)
        if result.outcome is not Outcome.SOLVED:
            raise GssError("the loops could not be compiled", got=f"{case.name}: the test frame was not solved")
    _compile_census(profile.camera)
    _compile_figures()
    _compile_patterns()
    for image in (pixels.astype(np.uint8), pixels.astype(np.uint16)):
        # A sensor's own chain uses these loops only after the compilation is marked as complete.
        find_blobs(image, float(image.max()) - 1, 1, kernels(fast=True))
    report(len(cases), len(cases), "")


def _compile_census(camera: Camera) -> None:
    """Compile the census of focal lengths and the fit of the mirror image, which the reference chain runs only for doubtful
    lists."""
    pixels = np.array([[0.25, 0.25], [0.75, 0.25], [0.5, 0.75]]) * [camera.columns, camera.rows]
    unit = camera.unproject(pixels)
    focal_objection(pixels, np.arange(3), unit, unit, camera, 1.0, fast=True)
    is_handed(unit, unit, 0.0, fast=True)


def _compile_figures() -> None:
    """Compile the match of figures of three to five stars, which only the chain of FAR-MST uses."""
    turn_rad = np.radians([0.0, 2.0, 5.0, 9.0, 14.0])
    unit = np.stack([np.sin(turn_rad), 0.1 * turn_rad, np.cos(turn_rad)], axis=1)
    unit /= lengths(unit)[:, None]
    directory = sin2_directory(distance_table_of_units(unit, 0.0, math.radians(20.0)), len(unit))
    consistent_names((0, 1, 2, 3, 4), baselines(unit, np.full((5, 5), 1e-6), directory, fast=True))


def _compile_patterns() -> None:
    """Compile the predictional estimate and the search for supporting spots, which only the chains of Oersted and AIM
    use."""
    unit, row = np.eye(3), np.arange(3)
    predictional_fit(unit, unit, row, unit, [1e-3], math.pi / 2, fast=True)
    spots, stars = PatternSpots(row, unit, np.zeros(3), np.zeros(3, bool)), pattern_stars(unit, np.zeros(3))
    pair = PairHypotheses(row[:1], row[1:2], row[:1], row[1:2], 1, 0)
    supporters(spots, pair, unit[None], stars, 1e-3, 0.1, fast=True)
