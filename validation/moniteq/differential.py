"""Small-angle attitude from four stars with one and with two cameras, against the rotation since the last attitude (Moniteq
1983 §6.2)."""

from __future__ import annotations

import numpy as np

from gss.domain.angles import ARCSEC_RAD, Array
from gss.domain.camera import Camera
from gss.domain.experiment import Cell, Experiment, Progress
from gss.domain.rotation import matrix_from_quaternion, random_quaternion, rotation_from_vector, rotation_y
from gss.domain.rotation import vector_from_rotation as vector_of
from gss.domain.stars import StarTable
from gss.instruments.registry import shipped_camera
from gss.pipeline.track.cameras_together import CameraView, body_attitude
from gss.pipeline.track.differential import differential_attitude

LIMIT_MAG = 7.0
STARS = 4
"""The on-board program uses four stars of a frame (Moniteq 1983 §6.1)."""
SIGMA_RAD = 0.5 * ARCSEC_RAD
"""Centroid error per axis (Moniteq 1983 §2.4)."""
EXCURSIONS_DEG = (0.1, 0.3, 1.0, 3.0)
SECOND_FROM_FIRST = rotation_y(np.pi / 2)


def moniteq_differential(stars: StarTable, trials: int, seed: int, progress: Progress) -> Experiment:
    """Measure the attitude error with one and with two cameras. ``trials``: attitudes per row."""
    camera, rng = shipped_camera("aim").camera, np.random.default_rng(seed)
    icrs = stars.brighter_than(LIMIT_MAG).icrs
    rows: list[tuple[Cell, ...]] = []
    for k, excursion_deg in enumerate(EXCURSIONS_DEG):
        for mounts in ((np.eye(3),), (np.eye(3), SECOND_FROM_FIRST)):
            errors = [e for _ in range(trials) if (e := _errors(icrs, camera, mounts, excursion_deg, rng)) is not None]
            rows.append(
                (
                    f"{excursion_deg:g}°, {len(mounts)} camera{'s'[: len(mounts) - 1]}",
                    "about 1″" if excursion_deg == 1.0 and len(mounts) == 1 else None,
                    *_figures(errors),
                    len(errors),
                )
            )
        progress((k + 1) / len(EXCURSIONS_DEG))
    return Experiment(
        "moniteq-differential",
        "Differential attitude with one and two cameras",
        "Moniteq 1983 §6.2",
        (
            "rotation since the last attitude",
            "paper, linear step, ″",
            "linear step, across, ″",
            "repeated, across, ″",
            "repeated, about the first boresight, ″",
            "predicted σ about it, ″",
            "attitudes",
        ),
        tuple(rows),
        (
            f"real stars to V {LIMIT_MAG:g}, the {STARS} nearest the boresight of each camera, centroid error "
            "0.5″ per axis",
            "second camera at 90°; rms over the attitudes at which each camera has enough stars",
        ),
        seed,
        (
            "The report states about 1″ for its form, which keeps terms of second order. The linear step alone "
            "is less accurate. Repeated until it converges, its result does not depend on the rotation.",
            "With one camera the rotation about the boresight is the weak axis. A second camera at 90° removes it.",
        ),
    )


def _figures(errors: list[tuple[Array, Array, Array]]) -> tuple[Cell, ...]:
    """Return the four rms values of a row; None without an attitude at which each camera has enough stars."""
    if not errors:
        return (None,) * 4
    linear, iterated, sigma = (
        np.sqrt(np.mean(np.square(part), axis=0)) / ARCSEC_RAD for part in zip(*errors, strict=True)
    )
    return _across(linear), _across(iterated), round(float(iterated[2]), 1), round(float(sigma[2]), 1)


def _across(rms_arcsec: Array) -> float:
    return round(float(np.hypot(rms_arcsec[0], rms_arcsec[1]) / np.sqrt(2)), 2)


def _errors(
    icrs: Array, camera: Camera, mounts: tuple[Array, ...], excursion_deg: float, rng: np.random.Generator
) -> tuple[Array, Array, Array] | None:
    """Return the (3,) rotation error of the linear step and of the repeated step, and the predicted σ, in body axes;
    None if a camera has too few stars in view."""
    truth = matrix_from_quaternion(random_quaternion(rng))
    axis = rng.normal(size=3)
    start = rotation_from_vector(axis / np.linalg.norm(axis) * np.radians(excursion_deg)) @ truth
    views = [_view(icrs, camera, mount.T @ truth, mount, rng) for mount in mounts]
    used = [view for view in views if view is not None]
    got = body_attitude(used, start) if len(used) == len(mounts) else None
    if got is None:
        return None
    measured = np.concatenate([view.measured_cam @ view.body_from_cam.T for view in used])
    linear = differential_attitude(measured, np.concatenate([view.reference_icrs for view in used]), start, steps=1)
    if linear is None:
        return None
    repeated = matrix_from_quaternion(got.quaternion)
    return vector_of(linear @ truth.T), vector_of(repeated @ truth.T), np.sqrt(np.diag(got.covariance_rad2))


def _view(
    icrs: Array, camera: Camera, cam_from_icrs: Array, body_from_cam: Array, rng: np.random.Generator
) -> CameraView | None:
    in_cone = icrs[icrs @ cam_from_icrs[2] > np.cos(camera.half_diagonal_rad)]
    cam = in_cone @ cam_from_icrs.T
    pixels = camera.project(cam)
    inside = camera.contains(pixels)
    cam, in_cone = cam[inside], in_cone[inside]
    if len(cam) < STARS:
        return None
    nearest = np.argsort(-cam[:, 2])[:STARS]
    noisy = cam[nearest] + rng.normal(scale=SIGMA_RAD, size=(STARS, 3))
    noisy /= np.linalg.norm(noisy, axis=1, keepdims=True)
    return CameraView(noisy, in_cone[nearest], np.full(STARS, SIGMA_RAD), body_from_cam)
