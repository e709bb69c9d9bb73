"""What the reference chain measures in a frame, and its results."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gss.domain.angles import Array
from gss.domain.camera import Camera
from gss.domain.results import Attitude, Centroids, Matches, Outcome, SolveResult, Turning
from gss.domain.rotation import quaternion_from_matrix
from gss.domain.sensor import Sensor
from gss.pipeline.detect import Detections
from gss.pipeline.refine import Refined
from gss.pipeline.streaks import measure_turning
from gss.pipeline.trace import Trace


@dataclass(frozen=True)
class MeasuredFrame:
    """What a run of the chain knows before the identification; every result contains it. ``camera``: stated or assumed geometry;
    ``detections``: None if only centroids were given; ``trace``: durations of the stages."""

    chain: str
    camera: Camera
    centroids: Centroids
    detections: Detections | None
    notes: tuple[str, ...]
    turning: Turning | None
    trace: Trace

    def unsolved(self, reason: str) -> SolveResult:
        """Return a result without a solution."""
        return SolveResult(
            self.chain,
            Outcome.NONE,
            reason,
            self.camera,
            self.detections.regions if self.detections else (),
            self.centroids,
            matches=None,
            attitude=None,
            false_match_probability=float("nan"),
            timing_s=dict(self.trace.timing_s),
            notes=self.notes,
            turning=self.turning,
            versions=self._versions,
        )

    def solved(
        self,
        fit: Refined,
        rows: NDArray[np.intp],
        hip: NDArray[np.int32],
        false_match_probability: float,
        velocity_c: Array | None,
    ) -> SolveResult:
        """Return the result of a fit to the matched (m,) rows of the centroids and (m,) stars. ``velocity_c``: (3,) ICRS
        velocity of the observer in units of c, which the fit took into account; None without aberration."""
        return SolveResult(
            self.chain,
            Outcome.SOLVED,
            "",
            fit.camera,
            self.detections.regions if self.detections else (),
            self.centroids,
            Matches(rows.astype(np.int32), hip.astype(np.int32), fit.weight, fit.residual_px),
            Attitude(quaternion_from_matrix(fit.cam_from_icrs), fit.covariance_rad2),
            false_match_probability,
            timing_s=dict(self.trace.timing_s),
            notes=self.notes,
            velocity_c=_as_velocity(velocity_c),
            turning=self.turning,
            versions=self._versions,
        )

    @property
    def _versions(self) -> dict[str, str]:
        return {"detect": self.detections.loops} if self.detections else {}


def turning_of(
    pixels: NDArray[Any],
    detections: Detections,
    camera: Camera,
    exposure_s: float,
    sensor: Sensor | None,
    fast: bool | None,
) -> Turning | None:
    """Return the rate measured from the trails of a frame, or None."""
    return measure_turning(
        pixels,
        detections.centroids,
        detections.background,
        camera,
        exposure_s,
        detections.psf_covariance_px2,
        psf_sigma_px=sensor.psf_sigma_px if sensor else None,
        e_per_dn=sensor.gain_e_per_dn if sensor else 0.0,
        saturation_dn=float(sensor.saturation_dn) if sensor else float(pixels.max()),
        fast=fast,
    )


def _as_velocity(velocity_c: Array | None) -> tuple[float, float, float] | None:
    """Return a velocity as plain numbers, for the result."""
    if velocity_c is None:
        return None
    x, y, z = (float(v) for v in velocity_c)
    return x, y, z
