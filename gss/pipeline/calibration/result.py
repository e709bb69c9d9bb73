"""Result of a self-calibration: the camera, its uncertainty, and the data to assess it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gss.domain.angles import Array
from gss.domain.camera import Camera
from gss.domain.errors import NotFound
from gss.domain.stars import Ids
from gss.pipeline.calibration.advice import Advice
from gss.pipeline.calibration.bundle import derivatives
from gss.pipeline.calibration.lens_models import Vector, vector_of
from gss.pipeline.calibration.residual_figures import ResidualFigures, ResidualMap
from gss.pipeline.calibration.star_stack import StarStack

GRID = 11


@dataclass(frozen=True)
class Parameter:
    """One fitted value in its unit; ``sigma`` includes the errors of all attitudes."""

    name: str
    value: float
    sigma: float
    unit: str


@dataclass(frozen=True)
class Frozen:
    """A parameter that was held at a value, and the reason. ``sigma``: what its standard deviation would be if it were fitted, NaN
    if unknown."""

    name: str
    value: float
    reason: str
    sigma: float


@dataclass(frozen=True)
class ModelFit:
    """One lens model fitted to the same stars. ``bic``, ``aicc``: differences from the best, 0 = best; ``held_out_px``: rms
    per axis of stars in held-out frames, corrected for the degrees of freedom of their attitudes."""

    model: str
    free_parameters: int
    bic: float
    aicc: float
    rms_px: float
    held_out_px: float
    chosen: bool
    frozen: tuple[str, ...]


@dataclass(frozen=True)
class FrameFit:
    """Fit of one frame. ``scale``: its plate scale relative to the start camera's; ``excluded``: "" or why it was excluded."""

    name: str
    time_s: float
    stars: int
    rejected: int
    rms_px: float
    quaternion: Array
    covariance_rad2: Array
    scale: float
    excluded: str = ""


@dataclass(frozen=True)
class StarResiduals:
    """Every input star. ``frame``: index into the frames used, ``residual_px``: (n, 2) measured − predicted after the calibration,
    ``before_px``: with the start camera and the best attitude for it, ``used``: False if rejected."""

    frame: NDArray[np.intp]
    hip: Ids
    v_mag: Array
    pixels: Array
    residual_px: Array
    before_px: Array
    used: NDArray[np.bool_]


@dataclass(frozen=True)
class CameraCalibration:
    """Camera calibrated from its frames. ``covariance``: of ``parameters`` in their order and units. ``held_out``: residuals in
    cross-validation, with only the attitudes fitted. ``before``: residuals of the start camera for the same stars."""

    camera: Camera
    model: str
    start: Camera
    parameters: tuple[Parameter, ...]
    covariance: Array
    frozen: tuple[Frozen, ...]
    residuals: ResidualFigures
    before: ResidualFigures
    held_out: ResidualFigures | None
    comparison: tuple[ModelFit, ...]
    frames: tuple[FrameFit, ...]
    before_map: ResidualMap
    after_map: ResidualMap
    stars: StarResiduals
    warnings: tuple[Advice, ...]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters, in the order of ``covariance``."""
        return tuple(p.name for p in self.parameters)

    def parameter(self, name: str) -> Parameter:
        """Return the fitted parameter of that name."""
        match = next((p for p in self.parameters if p.name == name), None)
        if match is None:
            raise NotFound("this parameter was not fitted", expected=" | ".join(self.names), got=name)
        return match

    def prediction_sigma_px(self, pixels: Array) -> Array:
        """(n,) σ per axis of the calibrated geometry at (n, 2) positions, excluding the part that is absorbed by an attitude fitted
        to stars all over the detector."""
        vector = vector_of(self.camera, self.model)
        vector = vector.without(tuple(n for n in vector.free if n not in self.names))
        free = len(vector.free)
        turn_over, moved_over = (d.reshape(2 * GRID * GRID, -1) for d in self._slopes(self._grid(), vector))
        fitted_turn = np.linalg.lstsq(turn_over, moved_over, rcond=None)[0]
        turn, moved = self._slopes(np.asarray(pixels, float), vector)
        remainder = moved - turn @ fitted_turn.reshape(3, free)
        scale = np.array([self._factor(n) for n in vector.free])
        inside = self.covariance / np.outer(scale, scale)
        return np.asarray(np.sqrt(np.maximum(np.einsum("nkp,pq,nkq->n", remainder, inside, remainder) / 2, 0)))

    def _grid(self) -> Array:
        col, row = np.meshgrid(
            np.linspace(0, self.camera.columns - 1, GRID), np.linspace(0, self.camera.rows - 1, GRID)
        )
        return np.column_stack([col.ravel(), row.ravel()])

    def _slopes(self, pixels: Array, vector: Vector) -> tuple[Array, Array]:
        unit = np.nan_to_num(self.camera.unproject(pixels))
        single_frame = StarStack(
            pixels, np.ones(len(pixels)), unit, np.zeros(len(pixels), np.intp), np.zeros(1, np.intp)
        )
        return derivatives(single_frame, vector, np.eye(3)[None])

    def _factor(self, name: str) -> float:
        """Conversion factor of the covariance from the units of the fit, which uses logarithms of focal length and aspect."""
        return self.parameter(name).value if name in ("focal_px", "aspect") else 1.0
