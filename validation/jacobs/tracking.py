"""Sunsat's tracking with false stars (Jacobs 1995 §4.3), and the cost of extracting a star by its area (§2.3, Fig. 2-7)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gss.domain.angles import Array
from gss.domain.experiment import Cell, Curve, Experiment, Progress, share_text
from gss.domain.results import Verdict
from gss.domain.rotation import quaternion_from_matrix, rotation_from_vector
from gss.domain.stars import StarTable
from gss.instruments.registry import shipped_camera
from gss.pipeline.chains.modes import AttitudePrior, Mode
from gss.pipeline.chains.onboard import Commanded, Work, solve
from gss.pipeline.chains.sunsat_detect import find_stars
from gss.pipeline.chains.sunsat_onboard import STAR_MS, STAR_PIXEL_MS, SunsatChain
from gss.pipeline.chains.sunsat_parameters import default_parameters
from gss.pipeline.regions import Pixels, find_blobs
from gss.pipeline.render import render
from gss.pipeline.score import assess
from validation.jacobs.sky import LIMITING_MAG, TABLE_3_5, bank_of, random_attitude

STEPS = 25
RATE_RAD_S = float(np.radians(0.1))
FIRST_ERROR_RAD = float(np.radians(0.5))
SKY_MAG = 7.0
DISC_AREA_PX = 100
DISC_DN = (4, 25)


@dataclass
class _TrackingTally:
    frames: int = 0
    tracked: int = 0
    imprecise: int = 0
    starts: int = 0
    wrong: int = 0
    windows: int = 0


def jacobs_tracking(stars: StarTable, trials: int, seed: int, progress: Progress) -> Experiment:
    """Track ``trials`` frames for each number of false stars, in runs of 25 frames. Each run has a new start
    attitude."""
    rows: list[tuple[Cell, ...]] = []
    runs = max(1, round(trials / STEPS))
    bank = bank_of(stars.brighter_than(LIMITING_MAG), shipped_camera("sunsat").camera)
    catalogue = SunsatChain().prepare(bank, shipped_camera("sunsat"))
    for number, false in enumerate((0, 100)):
        tally = _TrackingTally()
        for run in range(runs):
            progress((number + run / runs) / 2)
            rng = np.random.default_rng([seed, number, run])
            _run(stars.brighter_than(SKY_MAG), catalogue, false, rng, tally)
        rows.append(_row(false, tally))
    progress(1.0)
    return Experiment(
        "jacobs-tracking",
        "Sunsat's tracking among false stars",
        "Jacobs 1995 §4.3",
        (
            "false stars of about 100 pixels",
            "paper",
            "ours: frames with a correct attitude (95 %)",
            "of these beyond 3 σ",
            "frames started from other sensors' attitude",
            "wrong",
            "mean windows searched",
        ),
        tuple(rows),
        (
            f"{runs} runs of {STEPS} frames one second apart, rates uniform up to 0.1°/s per axis, exposure "
            f"{shipped_camera('sunsat').sensor.exposure_s:g} s, full catalogue to V {LIMITING_MAG:g}, "
            f"sky to V {SKY_MAG:g} with noise",
            "a run starts, and restarts after a failure, from an attitude with an error of up to 0.5° per axis "
            "(§4.1.6.2)",
            f"false stars are discs of {DISC_AREA_PX} pixels, {DISC_DN[0]} to {DISC_DN[1]} levels above the sky, "
            "at new positions each second",
        ),
        seed,
        (
            'The paper has no figures. It describes a few thousand iterations, "only occasionally resorting to '
            'the ADCS orientation".',
        ),
    )


def _run(stars: StarTable, catalogue: object, false: int, rng: np.random.Generator, tally: _TrackingTally) -> None:
    sunsat, chain = shipped_camera("sunsat"), SunsatChain()
    parameters = chain.parameters(sunsat, None, Commanded(), Mode.TRACKING)
    start, rate = random_attitude(TABLE_3_5, rng), rng.uniform(-RATE_RAD_S, RATE_RAD_S, 3)
    previous: list[Array] = []
    for step in range(STEPS):
        attitude = rotation_from_vector(-rate * step) @ start
        frame = render(stars, sunsat.camera, sunsat.sensor, attitude, sunsat.sensor.exposure_s, rng, rate_rad_s=rate)
        hint = (
            AttitudePrior.from_quaternion(previous[0], tuple(previous[1:3]))
            if previous
            else _other_sensors(attitude, rng)
        )
        tally.starts += not previous
        work = Work(sunsat.camera, catalogue, parameters, Mode.TRACKING, hint, frame.dark)
        result = solve(chain, with_discs(frame.pixels, false, rng), work)
        verdict = assess(result, frame.truth, sunsat.camera).verdict
        tally.frames += 1
        tally.tracked += verdict in (Verdict.CORRECT, Verdict.IMPRECISE)
        tally.imprecise += verdict is Verdict.IMPRECISE
        tally.wrong += verdict is Verdict.WRONG
        tally.windows += int(result.notes[0].split()[1])
        previous = [result.attitude.quaternion, *previous][:3] if result.attitude is not None else []


def _other_sensors(attitude: Array, rng: np.random.Generator) -> AttitudePrior:
    error = rotation_from_vector(rng.uniform(-FIRST_ERROR_RAD, FIRST_ERROR_RAD, 3))
    return AttitudePrior.from_quaternion(quaternion_from_matrix(error @ attitude))


def with_discs(pixels: Pixels, count: int, rng: np.random.Generator) -> NDArray[np.uint8]:
    """Return an eight-bit frame with ``count`` discs of about 100 pixels added, as in the document's simulation."""
    out = pixels.astype(int)
    half = int(np.ceil(np.sqrt(DISC_AREA_PX / np.pi)))
    row, col = np.indices((2 * half + 1, 2 * half + 1)) - half
    disc = (row**2 + col**2 <= DISC_AREA_PX / np.pi).astype(int)
    for _ in range(count):
        top, left = rng.integers(0, out.shape[0] - 2 * half), rng.integers(0, out.shape[1] - 2 * half)
        out[top : top + 2 * half + 1, left : left + 2 * half + 1] += disc * int(rng.integers(*DISC_DN))
    eight_bit: NDArray[np.uint8] = np.clip(out, 0, 255).astype(np.uint8)
    return eight_bit


def _row(false: int, tally: _TrackingTally) -> tuple[Cell, ...]:
    return (
        false,
        "smooth" if not false else "smooth, occasionally starting again",
        share_text(tally.tracked, tally.frames),
        tally.imprecise,
        f"{tally.starts} of {tally.frames}",
        tally.wrong,
        tally.windows / max(1, tally.frames),
    )


# Values of Fig. 2-7 in the text: three stars of 300 pixels in less than 100 ms; 900 pixels in 90 ms, of which 40 ms are
# needed to remove them.
PAPER_FIG_2_7_MS: dict[int, str] = {300: "under 33", 900: "90 (40 to remove it)"}


def jacobs_fig_2_7(stars: StarTable, trials: int, seed: int, progress: Progress) -> Experiment:
    """Measure the cost of extracting one star against its area: the number of neighbours examined, and the milliseconds
    that the chain assumes for its processor.

    ``trials``: discs drawn per area. ``stars`` is not used. ``seed`` affects only the positions of the discs."""
    parameters = default_parameters(shipped_camera("sunsat"))
    rng = np.random.default_rng(seed)
    rows: list[tuple[Cell, ...]] = []
    areas: list[float] = []
    cost: list[float] = []
    for number, count in enumerate((10, 30, 100, 200, 300, 600, 900)):
        progress(number / 7)
        area = pointings = accepted = 0
        for _ in range(trials):
            level = np.zeros((60, 60))
            row, col = np.indices(level.shape) - rng.uniform(29.0, 30.0, 2)[:, None, None]
            level[row**2 + col**2 <= count / np.pi] = 20.0
            size = int(find_blobs(level, parameters.threshold_dn).area_px.sum())
            area, pointings = area + size, pointings + 4 * size
            accepted += len(find_stars(level, parameters).centroids)
        mean = area / trials
        areas.append(mean)
        cost.append(STAR_MS + STAR_PIXEL_MS * mean)
        rows.append(
            (
                count,
                PAPER_FIG_2_7_MS.get(count),
                cost[-1],
                pointings / trials,
                "star" if 2 * accepted > trials else "no star",
            )
        )
    progress(1.0)
    return Experiment(
        "jacobs-fig-2-7",
        "Cost of extracting a star by its area",
        "Jacobs 1995 §2.3, Fig. 2-7, §4.3",
        ("area, pixels", "paper ms", "ours: ms of its processor", "neighbours examined", "accepted as"),
        tuple(rows),
        (f"{trials} discs per area, limits {parameters.min_area_px} to {parameters.max_area_px} pixels",),
        seed,
        (
            "The figure is missing from the document, but the text states some of its values. GSS gives the "
            "straight line through these values, as expected for growth over four neighbours.",
        ),
        (Curve("Fig. 2-7", "area, pixels", "ms", tuple(areas), tuple(cost)),),
    )
