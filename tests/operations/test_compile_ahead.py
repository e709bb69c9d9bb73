"""The solver's loops can be compiled before a frame needs them."""

from __future__ import annotations

import time
from dataclasses import replace

import pytest
from numba.core.dispatcher import Dispatcher

from gss.domain.errors import GssError
from gss.instruments.registry import shipped_camera, shipped_registry
from gss.operations.frames.compile_ahead import compile_ahead
from gss.operations.frames.solve import Solver
from gss.operations.frames.solver_cache import SolverCache
from gss.pipeline import compiled
from gss.pipeline.kernels import kernels


def test_every_loop_is_compiled_and_progress_is_reported() -> None:
    """After compilation every loop that Python calls has a signature. Progress is reported for each case."""
    steps: list[tuple[int, int, str]] = []
    cameras = shipped_registry()
    solver = Solver(cameras.camera, SolverCache(), time.perf_counter)
    compile_ahead(solver, cameras.camera("cubestar"), lambda *step: steps.append(step))
    assert [done for done, _, _ in steps] == [0, 1, 2, 3, 4]
    assert (steps[0][2], steps[-1]) == ("lost in space", (4, 4, ""))
    lists = kernels(fast=True).lists
    assert lists is not None
    called = [*vars(lists).values(), compiled._binomial_float, compiled._clip, compiled._maxima, compiled._fit]
    called += [compiled._lit, compiled._components]
    loops = [loop for loop in called if isinstance(loop, Dispatcher)]
    assert len(loops) >= 9
    assert [loop.py_func.__name__ for loop in loops if not loop.signatures] == []


def test_a_camera_that_does_not_solve_the_frame_is_an_error() -> None:
    """A camera that does not solve the frame is an error, because it is unknown which loops were compiled."""
    profile = shipped_camera("cubestar")
    geometry = replace(profile.camera, focal_col_px=1.4 * profile.camera.focal_col_px)
    other = replace(profile, camera=geometry)
    solver = Solver(lambda _name: other, SolverCache(), time.perf_counter)
    with pytest.raises(GssError, match="could not be compiled"):
        compile_ahead(solver, profile, lambda *_step: None)
