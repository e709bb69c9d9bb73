"""Attitude methods on a tumbling camera: errors, covariances and equality of the four methods (Huffman 2006 ch. 6, §8.2.6)."""

from __future__ import annotations

import numpy as np

from gss.domain.angles import ARCSEC_RAD, Array
from gss.domain.camera import Camera
from gss.domain.experiment import Cell, Experiment, Progress, share_text
from gss.domain.frames import pointing_difference_rad
from gss.domain.rotation import matrix_from_quaternion, random_quaternion, rotation_from_vector
from gss.domain.stars import StarTable
from gss.instruments.registry import shipped_camera
from gss.pipeline.chains.far_mst import attitude_of, covariance_of
from gss.pipeline.track.predictor import rotation_vector_rad

METHODS = {"q_method": "q-method", "quest": "QUEST", "svd": "SVD", "foam": "FOAM"}
FRAMES, STEP_RAD = 10, float(np.radians(1.0))
LIMIT_MAG, SIGMA_PX, MIN_STARS = 4.5, 0.3, 3
CROSS_ARCSEC, ROLL_ARCSEC = 100.0, 1080.0  # Table 1.3
THREE_SIGMA = 3.0


def huffman_6(stars: StarTable, trials: int, seed: int, progress: Progress) -> Experiment:
    """Solve the frames of random tumbles with each method. ``trials``: number of tumbles."""
    camera, bright = shipped_camera("far_mst").camera, stars.brighter_than(LIMIT_MAG).icrs
    errors: dict[str, list[Array]] = {m: [] for m in METHODS}
    sigmas: dict[str, list[Array]] = {m: [] for m in METHODS}
    apart: dict[str, float] = dict.fromkeys(METHODS, 0.0)
    solved = required = frames = 0
    for trial in range(trials):
        progress(trial / trials)
        rng = np.random.default_rng([seed, trial])
        start, axis = matrix_from_quaternion(random_quaternion(rng)), rng.normal(size=3)
        for k in range(FRAMES):
            truth = rotation_from_vector(k * STEP_RAD * axis / np.linalg.norm(axis)) @ start
            observed, reference = _observe(bright, camera, truth, rng)
            frames += 1
            if len(observed) < MIN_STARS:
                continue
            solved += 1
            weight = np.full(len(observed), 1.0 / len(observed))
            sigma_rad = np.full(len(observed), SIGMA_PX * camera.pixel_rad)
            found = {m: matrix_from_quaternion(attitude_of(observed, reference, weight, m)) for m in METHODS}
            for method, attitude in found.items():
                errors[method].append(rotation_vector_rad(attitude @ truth.T))
                sigmas[method].append(np.sqrt(np.diag(covariance_of(observed, reference, sigma_rad, method))))
                off = rotation_vector_rad(attitude @ found["q_method"].T)
                apart[method] = max(apart[method], float(np.linalg.norm(off)))
            cross_rad, roll_rad = pointing_difference_rad(found["quest"], truth)
            required += cross_rad <= CROSS_ARCSEC * ARCSEC_RAD and abs(roll_rad) <= ROLL_ARCSEC * ARCSEC_RAD
    progress(1.0)
    return Experiment(
        "huffman-6",
        "Attitude methods on a tumbling camera",
        "Huffman 2006 ch. 6, §8.2.6, Table 1.3",
        (
            "method",
            "rms error x, ″",
            "rms error y, ″",
            "rms error roll, ″",
            "error over predicted σ: x, y, roll",
            "errors within 3 σ (95 %)",
            "largest difference from the q-method, ″",
        ),
        tuple(_row(m, np.array(errors[m]), np.array(sigmas[m]), apart[m]) for m in METHODS),
        (
            f"{trials} tumbles of {FRAMES} frames, 1° per frame about a random axis; Hipparcos V ≤ {LIMIT_MAG:g} in the frame of "
            f"30.1° x 24.3°, centroid error {SIGMA_PX:g} px per axis, equal weights",
            f"frames with at least {MIN_STARS} stars: {share_text(solved, frames)}",
        ),
        seed,
        (
            "The document proposes to compare QUEST with the q-method and gives no figures. The four methods minimise the same "
            "loss: they differ by numeric precision only, so accuracy does not decide between them.",
            f"With QUEST, {share_text(required, solved)} of the solved frames meet the required 100″ across and 1080″ in roll "
            "(Table 1.3).",
            "The predicted σ uses the angle of a pixel at the centre. Off axis a pixel is smaller, so the errors are 3 % below it.",
            "Roll is the weakest axis, as the document states: the stars are at most 19° from the boresight.",
        ),
    )


def _observe(bright: Array, camera: Camera, truth: Array, rng: np.random.Generator) -> tuple[Array, Array]:
    """Return the (n, 3) measured directions of the stars in view and their catalogue directions."""
    ahead = bright[bright @ truth[2] > np.cos(camera.half_diagonal_rad)]
    pixels = camera.project(ahead @ truth.T)
    inside = camera.contains(pixels)
    measured = pixels[inside] + SIGMA_PX * rng.normal(size=(int(inside.sum()), 2))
    return camera.unproject(measured), ahead[inside]


def _row(method: str, errors: Array, sigmas: Array, apart_rad: float) -> tuple[Cell, ...]:
    rms = np.sqrt(np.mean(errors**2, axis=0)) / ARCSEC_RAD
    ratio = np.sqrt(np.mean((errors / sigmas) ** 2, axis=0))
    within = int(np.count_nonzero(np.abs(errors) <= THREE_SIGMA * sigmas))
    return (
        METHODS[method],
        *(round(float(v), 2) for v in rms),
        ", ".join(f"{v:.3f}" for v in ratio),
        share_text(within, errors.size),
        f"{apart_rad / ARCSEC_RAD:.1e}",
    )
