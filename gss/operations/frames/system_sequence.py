"""Solution of an image sequence as the processor of a system solves it: with the modes, the attitude history and the
chained attitudes of this system."""

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
"""Maximum number of successive frames whose attitude is chained by relative rotation. The number is limited because
errors accumulate while no star is identified."""
FRAME_STEP_S = 1.0
"""Assumed time between the images of a sequence. All five systems take images at equal steps."""


class SystemSequencer:
    """Processes images in the modes of one system (lost in space, assisted, tracking). Predictors and averages use up to two
    attitudes before the last one. If FAR-MST cannot identify an image, its attitude is the previous attitude chained with the
    rotation since the previous image (Huffman 2006 §7.2)."""

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
        self._last_rotation: Array | None = None
        self._chained = self._frame = 0

    def solve(self, solver: Solver, pixels: NDArray[Any], request: SolveRequest) -> SolveResult:
        """Solve the next image of the sequence."""
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
            result = self._with_chained_attitude(result, solver, request)
        return result

    def skip(self) -> None:
        """Continue after an image that could not be read: its time passes, and no rotation is measured across it."""
        self._frame += 1
        self._before = self._last_rotation = None

    def _with_chained_attitude(self, result: SolveResult, solver: Solver, request: SolveRequest) -> SolveResult:
        """Return the result of FAR-MST. If it has no attitude, return the previous attitude chained with the rotation since the
        previous image. This rotation is also the expected rotation to the next image."""
        before, rotation = self._before, None
        if before is not None:
            parameters = solver.parameters(request)
            relative = relative_attitude(
                before[0], result.centroids, result.camera, parameters, expected=self._last_rotation
            )
            rotation = relative.quaternion
            if result.attitude is None and rotation is not None and self._chained < MAX_CHAINED:
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
        self._last_rotation = rotation
        self._before = None if result.attitude is None else (result.centroids, result.attitude)
        return result
