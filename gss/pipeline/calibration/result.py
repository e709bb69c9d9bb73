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
from gss.pipeline.calibration.residual_figures import ResidualFigures, ResidualMap

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
