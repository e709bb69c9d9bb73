"""Limits of the constants that a rerun can change."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from gss.catalogue_tools.sources.hipparcos import load_stars
from gss.domain.errors import BadInput
from gss.domain.frames import cam_from_icrs
from gss.instruments.registry import shipped_camera, shipped_registry
from gss.operations.frames.solve import Solver, SolveRequest, options_of
from gss.operations.frames.solver_cache import SolverCache
from gss.pipeline.chains.systems import SYSTEMS
from gss.pipeline.render import render

SOLVER = Solver(shipped_camera, SolverCache(load_stars(8.0)))


@cache
def _frame(name: str) -> NDArray[Any]:
    known, stars, noise = shipped_camera(name), SOLVER.stars(None), np.random.default_rng(1)
    attitude = cam_from_icrs(1.4, 0.05, 0.3)
    return render(stars, known.camera, known.sensor, attitude, known.sensor.exposure_s, noise).pixels


def _with(name: str, constant: str, value: float) -> Callable[[], Any]:
    """Return a function that solves a frame with one constant changed."""
    current = getattr(SOLVER.parameters(SolveRequest(chain=name, profile=name)), constant)
    text = f"{value:.0f}" if isinstance(current, int | tuple) else repr(float(value))
    text = ",".join([text] * (len(current) if isinstance(current, tuple) else 1))
    return lambda: SOLVER.solve(_frame(name), SolveRequest(chain=name, profile=name, options=((constant, text),)))


def _limits(name: str) -> dict[str, tuple[float, float]]:
    return dict(SOLVER.parameters(SolveRequest(chain=name, profile=name)).limits)


@pytest.mark.parametrize("name", sorted(SYSTEMS))
def test_every_number_has_limits_that_contain_its_defaults(name: str) -> None:
    """Each number has limits, and its value for every shipped camera is within them."""
    limits = _limits(name)
    for instrument in shipped_registry().all():
        numbers = [o for o in options_of(name, instrument.profile) if o.kind in ("number", "integer", "numbers")]
        assert {o.name for o in numbers} == set(limits)
        for option in numbers:
            low, high = limits[option.name]
            assert all(low <= float(v) <= high for v in option.value.split(",") if v), (instrument.name, option)


@pytest.mark.parametrize("name", sorted(SYSTEMS))
def test_a_frame_is_processed_with_each_constant_at_its_limits(name: str) -> None:
    """At both limits of each constant, the chain gives an attitude or a reason."""
    for constant, limits in _limits(name).items():
        for value in limits:
            result = _with(name, constant, value)()
            assert result.attitude is not None or result.reason, (constant, value)


@pytest.mark.parametrize("name", sorted(SYSTEMS))
def test_values_outside_the_limits_are_rejected(name: str) -> None:
    """Values below and above the limits, NaN and infinity are rejected with the name and the limits."""
    for constant, (low, high) in _limits(name).items():
        for value in (low - max(1.0, abs(low)), 2 * high + 1):
            with pytest.raises(BadInput, match=f"{constant} is outside its limits.* to "):
                _with(name, constant, value)()
    numbers = [o.name for o in options_of(name, shipped_camera(name)) if o.kind == "number"]
    for constant in numbers:
        for text in ("nan", "inf", "-inf"):
            with pytest.raises(BadInput, match=f"{constant} is outside its limits"):
                options_of(name, shipped_camera(name), {constant: text})
