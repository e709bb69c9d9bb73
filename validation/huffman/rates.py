"""LIST: angular rates from the stars of successive frames without a catalogue (Huffman 2006 Table 1.3, §5.5)."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np

from gss.domain.angles import ARCSEC_RAD, Array
from gss.domain.experiment import Cell, Experiment, Progress, share_text
from gss.domain.rotation import matrix_from_quaternion, random_quaternion, rotation_from_vector
from gss.domain.stars import StarTable
from gss.instruments.registry import shipped_camera
from gss.pipeline.chains.far_mst_detect import find_centroids
from gss.pipeline.chains.far_mst_parameters import FarMstParameters, default_parameters
from gss.pipeline.chains.star_rates import rate_from_stars
from gss.pipeline.rates import Rate
from gss.pipeline.render import render

RATES_DEG_S = (0.1, 0.5, 1.0, 2.0)
FRAMES, INTERVAL_S = 4, 1.0
CROSS_ARCSEC, ROLL_ARCSEC = 70.0, 1080.0
WRONG_ARCSEC = 1800.0
DEEPEST_MAG = 6.5


@dataclass
class _Tally:
    """Errors of the measured rates in rad/s, and their ratio to σ, per axis. ``intervals``: all pairs of frames."""

    intervals: int = 0
    errors: list[Array] = field(default_factory=list)
    ratios: list[Array] = field(default_factory=list)


def huffman_1_3(stars: StarTable, trials: int, seed: int, progress: Progress) -> Experiment:
    """Measure the rates of tumbling cameras. ``trials``: number of sequences per rate."""
    base = default_parameters(shipped_camera("far_mst"))
    variants = {
        "3 brightest stars, as the document": replace(base, max_centroids=3, acceptance="document"),
        "all stars, bound on accidental matches": base,
    }
    sky, rows = stars.brighter_than(DEEPEST_MAG), []
    for k, rate_deg_s in enumerate(RATES_DEG_S):
        tallies = {name: _Tally() for name in variants}
        for trial in range(trials):
            progress((k + trial / trials) / len(RATES_DEG_S))
            _tumble(sky, rate_deg_s, variants, tallies, np.random.default_rng([seed, k, trial]))
        rows += [_row(rate_deg_s, name, tally) for name, tally in tallies.items()]
    progress(1.0)
    return Experiment(
        "huffman-1-3",
        "LIST: rates from stars without a catalogue",
        "Huffman 2006 Table 1.3, §1.3, §5.5",
        (
            "rate, °/s",
            "stars and acceptance",
            "intervals with a rate (95 %)",
            "rms error x, y, ″/s",
            "rms error roll, ″/s",
            "within 70″ and 1080″ (95 %)",
            "within 3 σ (95 %)",
            "wrong",
        ),
        tuple(rows),
        (
            f"{trials} sequences of {FRAMES} rendered frames per rate, {INTERVAL_S:g} s apart, constant rate about a random axis; "
            "camera of the package far_mst (30.1° x 24.3°, exposure 0.1 s)",
            f"the error is that of the rotation in one interval; wrong: more than {WRONG_ARCSEC / 3600:g}° off",
        ),
        seed,
        (
            "The goals of Table 1.3 for LIST are 70″ in pitch and yaw and 1080″ in roll at 1 Hz with fewer than four stars, and "
            "§1.3 states rates up to 1°/s. The document reports no measurement of LIST.",
            "The document gives no separate optics for LIST. Its imager is that of FAR-MST (§2.2.3), so the camera of "
            "FAR-MST is used; Table 1.3 states a field of 30°.",
            "If the three brightest stars of two frames differ, three stars give no rate or, rarely, a wrong one: nothing confirms "
            "them. With all stars the bound rejects accidental matches.",
        ),
    )


def _tumble(
    sky: StarTable,
    rate_deg_s: float,
    variants: dict[str, FarMstParameters],
    tallies: dict[str, _Tally],
    rng: np.random.Generator,
) -> None:
    """Render one sequence and measure its rates with each variant."""
    profile = shipped_camera("far_mst")
    camera, sensor = profile.camera, profile.sensor
    start, axis = matrix_from_quaternion(random_quaternion(rng)), rng.normal(size=3)
    truth = np.radians(rate_deg_s) * axis / np.linalg.norm(axis)
    frames = [
        render(
            sky,
            camera,
            sensor,
            rotation_from_vector(-truth * INTERVAL_S * k) @ start,
            sensor.exposure_s,
            rng,
            rate_rad_s=truth,
        ).pixels
        for k in range(FRAMES)
    ]
    for name, parameters in variants.items():
        lists, previous = [find_centroids(pixels, parameters).centroids for pixels in frames], None
        for before, after in pairwise(lists):
            previous = rate_from_stars(before, after, camera, parameters, INTERVAL_S, previous=previous).rate
            _count(tallies[name], previous, truth)


def _count(tally: _Tally, rate: Rate | None, truth_rad_s: Array) -> None:
    tally.intervals += 1
    if rate is not None:
        error = rate.vector_rad_s - truth_rad_s
        tally.errors.append(error)
        tally.ratios.append(error / np.array(rate.sigma_rad_s))


def _row(rate_deg_s: float, name: str, tally: _Tally) -> tuple[Cell, ...]:
    errors = np.array(tally.errors).reshape(-1, 3) / ARCSEC_RAD
    is_wrong = np.abs(errors).max(axis=1, initial=0.0) > WRONG_ARCSEC
    right, ratios = errors[~is_wrong], np.array(tally.ratios).reshape(-1, 3)[~is_wrong]
    cross = np.abs(right[:, :2]).max(axis=1, initial=0.0)
    fits = int(np.count_nonzero((cross <= CROSS_ARCSEC) & (np.abs(right[:, 2]) <= ROLL_ARCSEC)))
    rms = np.sqrt(np.mean(right**2, axis=0)) if len(right) else np.full(3, np.nan)
    return (
        rate_deg_s,
        name,
        share_text(len(errors), tally.intervals),
        ", ".join(f"{v:.1f}" for v in rms[:2]),
        f"{rms[2]:.0f}",
        share_text(fits, len(errors)),
        share_text(int(np.count_nonzero(np.abs(ratios) <= 3)), ratios.size),
        int(is_wrong.sum()),
    )
