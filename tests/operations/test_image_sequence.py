"""Rates, hints and notes of image sequences."""

from __future__ import annotations

from datetime import datetime

import numpy as np
import pytest

from gss.domain.camera import Camera
from gss.domain.frames import cam_from_icrs
from gss.domain.results import Attitude, Centroids, Outcome, SolveResult
from gss.domain.rotation import quaternion_from_matrix
from gss.operations.frames.image_sequence import RateRecord, Sequencer
from gss.operations.frames.solve import SolveRequest
from gss.operations.frames.system_sequence import SystemSequencer

CAMERA = Camera.from_fov(1024, 1024, np.radians(20))
PIXELS = np.zeros((8, 8), np.uint8)


class PlannedSolver:
    """Solver with planned results: a right ascension in degrees, or None for no solution. ``hints``: True for each call with
    a hint."""

    def __init__(self, *planned: float | None) -> None:
        self.planned, self.hints = list(planned), []

    def solve(self, pixels: np.ndarray, request: SolveRequest) -> SolveResult:
        self.hints.append(request.hint is not None)
        ra_deg = self.planned.pop(0)
        attitude = None
        if ra_deg is not None:
            rotation = cam_from_icrs(np.radians(ra_deg), 0.2, 0.1)
            attitude = Attitude(quaternion_from_matrix(rotation), np.eye(3) * 1e-10)
        outcome, reason = (Outcome.NONE, "too few stars") if ra_deg is None else (Outcome.SOLVED, "")
        centroids = Centroids.from_pixels(np.empty((0, 2)))
        return SolveResult("reference", outcome, reason, CAMERA, (), centroids, None, attitude, 0.0)


def solved(
    sequencer: Sequencer, solver: PlannedSolver, at: datetime | None = None
) -> tuple[SolveResult, RateRecord | None]:
    return sequencer.solve(solver, PIXELS, SolveRequest(profile="cubestar"), at)


def test_no_rate_is_measured_across_an_image_that_could_not_be_read() -> None:
    """The interval between images is not the one between the images before and after an unreadable one. As after an image
    without a solution, there is no rate and no hint. The next pair of images has both again."""
    sequencer, solver = Sequencer(True, 10.0, None), PlannedSolver(0, 2, 3)
    solved(sequencer, solver)
    sequencer.skip()
    assert solved(sequencer, solver)[1] is None
    rate = solved(sequencer, solver)[1]
    assert rate is not None
    assert rate["speed_deg_s"] == pytest.approx(0.1)
    assert solver.hints == [False, False, True]


def test_an_image_is_solved_after_a_half_turn() -> None:
    """If the rotation since the previous image has no unique direction, the image has a solution and no rate."""
    sequencer, solver = Sequencer(True, 10.0, None), PlannedSolver(0, 178, 179)
    solved(sequencer, solver)
    result, rate = solved(sequencer, solver)
    assert (result.outcome, rate) == (Outcome.SOLVED, None)
    assert solved(sequencer, solver)[1] is not None


@pytest.mark.parametrize(("second", "notes"), [(4, 1), (None, 0)])
def test_recovery_is_noted_only_if_the_image_was_solved(second: float | None, notes: int) -> None:
    """The note on the recovery without a hint is in the result only if this attempt solved the image."""
    sequencer, solver = Sequencer(True, 10.0, None), PlannedSolver(0, None, second)
    solved(sequencer, solver)
    result, _ = solved(sequencer, solver)
    assert len(result.notes) == notes
    assert solver.hints == [False, True, False]


def test_the_time_of_a_skipped_image_passes_for_a_system() -> None:
    """A skipped image counts as an image of the sequence of a system, without a rotation to the next one."""
    sequencer = Sequencer(True, 1.0, None)
    sequencer._system = system = SystemSequencer("far_mst")
    system._last_rotation = np.array([0, 0, 0, 1.0])
    sequencer.skip()
    assert (system._frame, system._before, system._last_rotation) == (1, None, None)
