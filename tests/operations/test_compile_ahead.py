"""The solver's loops can be compiled before a frame needs them."""

from __future__ import annotations

import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from inspect import isfunction
from multiprocessing import get_context
from types import ModuleType

import pytest
from numba.core.dispatcher import Dispatcher

from gss.domain.errors import GssError
from gss.instruments.registry import shipped_camera, shipped_registry
from gss.operations.frames.compile_ahead import compile_ahead
from gss.operations.frames.solve import Solver
from gss.operations.frames.solver_cache import SolverCache
from gss.pipeline.kernels import kernels
from gss.pipeline.loops import background, census, geometry, peaks, pixels, predictional, stamps, supporters, trails


def test_every_loop_is_compiled_and_progress_is_reported() -> None:
    """After compilation every loop that Python calls has a signature. Progress is reported for each case. A new process
    compiles them, because other tests call loops too.
    """
    with ProcessPoolExecutor(1, get_context("spawn")) as process:
        steps, count, missing = process.submit(compiled_in_advance).result()
    assert [done for done, _, _ in steps] == [0, 1, 2, 3, 4, 5, 6]
    assert (steps[0][2], steps[-1]) == ("lost in space", (6, 6, ""))
    assert count >= 20
    assert missing == []


def compiled_in_advance() -> tuple[list[tuple[int, int, str]], int, list[str]]:
    """Compile the loops. Return the reported steps, the number of loops that Python calls, and the names of those without a
    signature."""
    steps: list[tuple[int, int, str]] = []
    cameras = shipped_registry()
    solver = Solver(cameras.camera, SolverCache(), time.perf_counter)
    compile_ahead(solver, cameras.camera("cubestar"), lambda *step: steps.append(step))
    lists = kernels(fast=True).lists
    assert lists is not None
    called = [loop for loop in vars(lists).values() if isinstance(loop, Dispatcher)]
    for module in (background, census, geometry, peaks, pixels, predictional, stamps, supporters, trails):
        called += called_from_python(module)
    return steps, len(called), [loop.py_func.__name__ for loop in called if not loop.signatures]


def called_from_python(module: ModuleType) -> list[Dispatcher]:
    """Return the loops of a module that its plain functions call. Loops that only loops call can lack a signature, because
    the caller is read from the disk with them."""
    functions = [value for value in vars(module).values() if isfunction(value) and value.__module__ == module.__name__]
    names = {name for function in functions for name in function.__code__.co_names}
    return [value for name, value in vars(module).items() if isinstance(value, Dispatcher) and name in names]


def test_a_camera_that_does_not_solve_the_frame_is_an_error() -> None:
    """A camera that does not solve the frame is an error, because it is unknown which loops were compiled."""
    profile = shipped_camera("cubestar")
    geometry = replace(profile.camera, focal_col_px=1.4 * profile.camera.focal_col_px)
    other = replace(profile, camera=geometry)
    solver = Solver(lambda _name: other, SolverCache(), time.perf_counter)
    with pytest.raises(GssError, match="could not be compiled"):
        compile_ahead(solver, profile, lambda *_step: None)
