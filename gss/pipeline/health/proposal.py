"""Calibration proposed from the health of a sensor: camera parameters from the latest trends, and bad pixels."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gss.domain.camera import Brown, Camera, Pinhole
from gss.domain.camera_profile import CameraProfile
from gss.pipeline.health.frame_figures import COLOURS
from gss.pipeline.health.mission import FigureCourse, MissionHealth
from gss.pipeline.health.trend import DAY_S, Z95, Estimate, Trend


@dataclass(frozen=True)
class ProposedChange:
    """Change of one value of the calibration: the old value, and the new value with its 95 % interval."""

    name: str
    unit: str
    old: float
    new: Estimate


@dataclass(frozen=True)
class Proposal:
    """Proposed calibration. ``profile``: profile with the new values; ``changes``: significant changes; ``bad`` (k, 2):
    column and row of the pixels that are warm at the end; ``left_out``: changes that the lens model cannot express."""

    profile: CameraProfile
    changes: tuple[ProposedChange, ...]
    bad: NDArray[np.intp]
    left_out: tuple[str, ...]


def value_at(trend: Trend, time_s: float) -> Estimate:
    """Return the fitted value and its interval at a time and the mean temperature."""
    row = np.zeros(len(trend.covariance))
    row[0], row[1] = 1.0, (time_s - trend.middle_s) / DAY_S
    first = 2 if trend.per_k is None else 3
    row[first:] = [float(j.time_s.value <= time_s) for j in trend.jumps]
    value = float(trend.at(np.array([time_s]))[0])
    half = Z95 * float(np.sqrt(row @ trend.covariance @ row))
    return Estimate(value, value - half, value + half)


def proposed(health: MissionHealth, profile: CameraProfile) -> Proposal:
    """Return the calibration at the time of the last frame. ``profile``: the calibration relative to which changes were
    measured. A value does not change if its interval contains the old value."""
    end_s = float(health.times_s[-1])
    changes: list[ProposedChange] = []
    left_out: list[str] = []

    def changed(figure: FigureCourse, old: float) -> float | None:
        if figure.trend is None:
            return None
        new = value_at(figure.trend, end_s)
        if new.contains(old):
            return None
        changes.append(ProposedChange(figure.name, figure.unit, old, new))
        return new.value

    camera = profile.camera
    focal = changed(health.figure("focal length"), camera.focal_col_px)
    column = changed(health.figure("centre column"), camera.centre_col_px)
    row = changed(health.figure("centre row"), camera.centre_row_px)
    bend_px = changed(health.figure("distortion"), 0.0)
    scale = 1.0 if focal is None else focal / camera.focal_col_px
    moved = replace(
        camera,
        focal_col_px=camera.focal_col_px * scale,
        focal_row_px=camera.focal_row_px * scale,
        centre_col_px=camera.centre_col_px if column is None else column,
        centre_row_px=camera.centre_row_px if row is None else row,
    )
    if bend_px is not None:
        bent = _bent(moved, bend_px)
        if bent is None:
            left_out.append(f"distortion of {bend_px:.2g} px at the corner: the lens model has no such term")
            changes.pop()
        moved = bent or moved
    light = _light(health, end_s)
    sensor = profile.sensor
    if light is not None and not light.contains(0.0):
        changes.append(ProposedChange("light", "mag", 0.0, light))
        sensor = replace(sensor, zero_point_e_s=sensor.zero_point_e_s * float(10 ** (-0.4 * light.value)))
    warm = [(p.col, p.row) for p in health.pixels if p.now_e_s.value > health.warm_e_s]
    return Proposal(
        replace(profile, camera=moved, sensor=sensor),
        tuple(changes),
        np.array(warm, np.intp).reshape(-1, 2),
        tuple(left_out),
    )


def _bent(camera: Camera, corner_px: float) -> Camera | None:
    """Return the camera with additional third-order distortion. None if its lens model has no such term."""
    half_px = float(np.hypot(camera.columns, camera.rows)) / 2
    k1 = corner_px * camera.focal_col_px**2 / half_px**3
    if isinstance(camera.distortion, Brown):
        return replace(camera, distortion=replace(camera.distortion, k1=camera.distortion.k1 + k1))
    return replace(camera, distortion=Brown(k1=k1)) if isinstance(camera.distortion, Pinhole) else None


def _light(health: MissionHealth, end_s: float) -> Estimate | None:
    """Return the magnitudes lost relative to the zero point, as the weighted mean over the star colours. None without a
    trend. The interval includes the difference between the colours."""
    trends = [health.figure(f"light of {name} stars").trend for name, _, _ in COLOURS]
    trend_values = [value_at(t, end_s) for t in trends if t is not None]
    if not trend_values:
        return None
    values = np.array([e.value for e in trend_values])
    weights = np.array([1 / max(e.high - e.low, 1e-6) ** 2 for e in trend_values])
    mean = float(values @ weights / weights.sum())
    half = float(np.sqrt(0.25 / weights.sum() + np.var(values)))
    return Estimate(mean, mean - half, mean + half)
