"""Result of a self-calibration: the camera, its uncertainty, and data to assess the result."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gss.domain.angles import Array
from gss.domain.camera import Camera
from gss.domain.errors import NotFound
from gss.domain.stars import Ids
from gss.pipeline.calibration.advice import Advice
from gss.pipeline.calibration.residual_figures import ResidualFigures, ResidualMap

GRID = 11


@dataclass(frozen=True)
class Parameter:
    """Fitted parameter in its unit. ``sigma`` includes the errors of all attitudes."""

    name: str
    value: float
    sigma: float
    unit: str


@dataclass(frozen=True)
class Frozen:
    """Parameter that was fixed at a value, and the reason. ``sigma``: standard deviation that a fit would give, NaN if unknown."""

    name: str
    value: float
    reason: str
    sigma: float


@dataclass(frozen=True)
class ModelFit:
    """Fit of one lens model to the common stars. ``bic``, ``aicc``: information criteria minus those of the best model,
    so 0 for the best model; ``held_out_px``: rms per axis of the stars in held-out frames, corrected for the degrees of
    freedom of the attitudes of these frames."""

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
    """Fit of one frame. ``scale``: plate scale relative to that of the start camera; ``excluded``: "" or the reason for
    exclusion."""

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
    """Residuals of all input stars. ``frame``: index into the frames used; ``residual_px``: (n, 2) measured − predicted
    after the calibration; ``before_px``: measured − predicted with the start camera and the attitude that fits it best;
    ``used``: False if rejected."""

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
        """Return the names of the parameters, in the order of ``covariance``."""
        return tuple(p.name for p in self.parameters)

    def parameter(self, name: str) -> Parameter:
        """Return the fitted parameter with this name. Raises NotFound if it was not fitted."""
        match = next((p for p in self.parameters if p.name == name), None)
        if match is None:
            raise NotFound("this parameter was not fitted", expected=" | ".join(self.names), got=name)
        return match
