"""Chains of the systems on the ground, with their modes, methods and constants."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gss.catalogue_tools.sources.hipparcos import load_stars
from gss.domain.angles import Array
from gss.domain.errors import BadInput
from gss.domain.frames import cam_from_icrs, pointing_difference_rad
from gss.domain.results import Outcome
from gss.domain.rotation import rotation_from_vector
from gss.instruments.registry import shipped_camera
from gss.operations.frames.solve import Solver, SolveRequest
from gss.operations.frames.solver_cache import SolverCache
from gss.operations.frames.system_sequence import SystemSequencer
from gss.pipeline.chains.modes import Mode
from gss.pipeline.chains.onboard import Commanded
from gss.pipeline.chains.options import names, parse, with_options
from gss.pipeline.chains.systems import SYSTEMS, system
from gss.pipeline.identify.near import BoundedPrior
from gss.pipeline.render import render

STARS = load_stars(8.0)
SOLVER = Solver(shipped_camera, SolverCache(STARS))
START = cam_from_icrs(1.4, 0.05, 0.3)


def _frame(name: str, attitude: Array, seed: int = 3, shown: bool = True) -> np.ndarray:
    known = shipped_camera(name)
    stars = STARS if shown else STARS.take(np.zeros(0, np.intp))
    return render(
        stars, known.camera, known.sensor, attitude, known.sensor.exposure_s, np.random.default_rng(seed)
    ).pixels


def _attitude_at(step: int) -> Array:
    """Return the attitude of a slow rotation of 3′ per frame."""
    return np.asarray(rotation_from_vector(np.radians([0.03, -0.04, 0.02]) * step) @ START)


@pytest.mark.parametrize(
    ("name", "option"),
    [
        ("sunsat", "matcher=star_vectors"),
        ("sunsat", "acceptance=document"),
        *(("far_mst", f"matcher={m}") for m in ("n3", "n4", "n5", "pyramid", "pivot")),
        *(("far_mst", f"attitude_method={m}") for m in ("q_method", "svd", "foam", "pad")),
        *(("far_mst", f"prefilter={m}") for m in ("block", "none")),
        ("far_mst", "centroider=mle"),
        ("cubestar", "acceptance=document"),
        ("cubestar", "undistort=document"),
        ("oersted", "triplets_alone=0"),
        ("oersted", "acceptance=document"),
        ("oersted", "averaged=3"),
    ],
)
def test_every_method_of_a_document_can_be_selected(name: str, option: str) -> None:
    """A method selected by name solves the frame or gives a reason, and never a wrong attitude."""
    attitude = START
    request = SolveRequest(chain=name, profile=name, options=tuple(parse([option]).items()))
    result = SOLVER.solve(_frame(name, attitude), request)
    if result.attitude is None:
        assert result.reason
        assert option in ("centroider=mle", "prefilter=none", "undistort=document"), result.reason
        return
    across = pointing_difference_rad(result.attitude.cam_from_icrs, attitude)[0]
    assert across < 3 * shipped_camera(name).camera.pixel_rad


@pytest.mark.parametrize("name", ["cubestar", "sunsat", "far_mst", "oersted"])
def test_a_sequence_changes_from_lost_to_tracking(name: str) -> None:
    """The first image is solved lost in space and the next ones in tracking mode. After a blank image the next one is
    solved again."""
    sequence, modes = SystemSequencer(name), []
    for step, shown in enumerate((True, True, True, False, True)):
        result = sequence.solve(
            SOLVER, _frame(name, _attitude_at(step), step, shown), SolveRequest(chain=name, profile=name)
        )
        modes.append(next(n for n in result.notes if n.startswith("mode")))
        if result.attitude is not None:
            error_rad = pointing_difference_rad(result.attitude.cam_from_icrs, _attitude_at(step))[0]
            assert error_rad < 3 * shipped_camera(name).camera.pixel_rad
    assert modes[:3] == ["mode: lost in space", "mode: tracking", "mode: tracking"]
    assert result.outcome is Outcome.SOLVED, result.reason


def test_a_hint_starts_in_assisted_mode() -> None:
    """A commanded attitude starts the sequence in assisted mode with its radius."""
    sequence = SystemSequencer("cubestar", BoundedPrior(_attitude_at(20), float(np.radians(4))))
    result = sequence.solve(SOLVER, _frame("cubestar", START), SolveRequest(chain="cubestar", profile="cubestar"))
    assert "mode: assisted" in result.notes
    assert result.outcome is Outcome.SOLVED


def test_far_mst_bridges_an_image_that_it_cannot_match() -> None:
    """If too few stars are matched, the attitude is propagated by the rotation between images, with a note."""
    sequence = SystemSequencer("far_mst")
    request = SolveRequest(chain="far_mst", profile="far_mst")
    first = sequence.solve(SOLVER, _frame("far_mst", _attitude_at(0), 0), request)
    assert first.outcome is Outcome.SOLVED
    unmatchable = replace(request, options=(("min_identified", "30,30,30"),))
    second = sequence.solve(SOLVER, _frame("far_mst", _attitude_at(1), 1), unmatchable)
    assert second.attitude is not None, second.reason
    assert any("chained over 1 image" in note for note in second.notes)
    assert (
        pointing_difference_rad(second.attitude.cam_from_icrs, _attitude_at(1))[0]
        < shipped_camera("far_mst").camera.pixel_rad
    )
    assert second.attitude.sigma_rad[0] > first.attitude.sigma_rad[0]  # type: ignore[union-attr]


@pytest.mark.parametrize("name", sorted(SYSTEMS))
def test_options_change_only_the_named_constants(name: str) -> None:
    """If every constant is given as text with its current value, the parameters are unchanged."""
    parameters = system(name).parameters(shipped_camera(name), None, Commanded(), Mode.LOST_IN_SPACE)
    given = {n: getattr(parameters, n) for n in names(parameters) if getattr(parameters, n) is not None}
    texts = {n: ",".join(map(repr, v)) if isinstance(v, tuple) else str(v) for n, v in given.items()}
    assert with_options(parameters, texts) == parameters


@pytest.mark.parametrize(
    ("pair", "words"),
    [
        ("nonsense=1", "no such constant"),
        ("min_area_px=x", "another kind"),
        ("matcher=x", "matcher"),
        ("y", "NAME=VALUE"),
    ],
)
def test_invalid_options_are_rejected(pair: str, words: str) -> None:
    """Unknown names, wrong kinds, unknown methods and texts without a value give an error message."""
    parameters = system("sunsat").parameters(shipped_camera("sunsat"), None, Commanded(), Mode.LOST_IN_SPACE)
    with pytest.raises(BadInput, match=words):
        with_options(parameters, parse([pair]))


def test_the_reference_chain_has_no_options() -> None:
    """Options of the reference chain are rejected."""
    with pytest.raises(BadInput, match="no constants"):
        SOLVER.solve(_frame("cubestar", START), SolveRequest(profile="cubestar", options=(("a", "1"),)))
