"""Solves a sequence of images as a system's own processor would: with its modes, attitude history and chained attitudes."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from numpy.typing import NDArray

from gss.domain.angles import Array
from gss.domain.results import Attitude, Centroids, Outcome, SolveResult
from gss.domain.rotation import quaternion_from_matrix
from gss.operations.frames.solve import Solver, SolveRequest, Started
from gss.pipeline.chains import far_mst_parameters
from gss.pipeline.chains.apriori import PriorState
from gss.pipeline.chains.far_mst_relative import chained, relative_attitude
from gss.pipeline.chains.modes import Mode
from gss.pipeline.chains.systems import system
from gss.pipeline.identify import near

MAX_CHAINED = 5
"""Maximum number of successive frames with an attitude chained by relative rotation; errors accumulate and no star is
identified."""
FRAME_STEP_S = 1.0
"""Images of a sequence are taken at equal steps, like the images of all five systems."""


class SystemSequencer:
    """Processes images in the modes of one system (lost in space, assisted, tracking), with up to two attitudes before the
    last for predictors and averages. FAR-MST chains the attitude of images it cannot identify by the rotation since the
    previous one (Huffman 2006 §7.2)."""

    def __init__(self, chain: str, hint: near.BoundedPrior | None = None) -> None:
        self._chain = system(chain)
        self._mode, self._prior = Mode.LOST_IN_SPACE, PriorState()
        if hint is not None:
            quaternion = quaternion_from_matrix(hint.cam_from_icrs)
            self._mode, self._prior = (
                Mode.ASSISTED,
                PriorState(commanded=quaternion, commanded_radius_rad=hint.radius_rad),
            )
        self._before: tuple[Centroids, Attitude] | None = None
        self._turn: Array | None = None
        self._chained = self._frame = 0

    def solve(self, solver: Solver, pixels: NDArray[Any], request: SolveRequest) -> SolveResult:
        """Solve the next image."""
        mode = self._prior.usable(self._mode, self._frame * FRAME_STEP_S, self._chain.oldest_attitude_s)
        radius_rad = self._prior.radius_rad(mode) if mode is Mode.ASSISTED else None
        started = Started(mode, self._prior.hint(mode, self._frame * FRAME_STEP_S), radius_rad)
        result = solver.solve(pixels, replace(request, hint=None, started=started))
        result = replace(result, notes=(*result.notes, f"mode: {mode.value.replace('_', ' ')}"))
        solved = result.outcome is Outcome.SOLVED
        self._mode = self._chain.next_mode(mode, solved)
        quaternion = result.attitude.quaternion if result.attitude is not None else None
        self._prior = self._prior.after(quaternion, self._frame * FRAME_STEP_S)
        self._frame += 1
        if self._chain.name == far_mst_parameters.NAME:
            result = self._bridged(result, solver, request)
        return result

    def _bridged(self, result: SolveResult, solver: Solver, request: SolveRequest) -> SolveResult:
        """Return FAR-MST's result, or the previous attitude chained with the rotation since. The rotation is also the
        expected one for the next image."""
        before, turn = self._before, None
        if before is not None:
            parameters = solver.parameters(request)
            relative = relative_attitude(before[0], result.centroids, result.camera, parameters, expected=self._turn)
            turn = relative.quaternion
            if result.attitude is None and turn is not None and self._chained < MAX_CHAINED:
                self._chained += 1
                since = f"attitude chained over {self._chained} image{'s' if self._chained > 1 else ''}"
                result = replace(
                    result,
                    outcome=Outcome.SOLVED,
                    reason="",
                    attitude=chained(before[1], relative),
                    false_match_probability=relative.false_match_probability,
                    notes=(
                        *result.notes,
                        f"{since}: {len(relative.pairs)} stars matched to the previous image, none identified: {result.reason}",
                    ),
                )
            elif result.attitude is not None:
                self._chained = 0
        self._turn = turn
        self._before = None if result.attitude is None else (result.centroids, result.attitude)
        return result
