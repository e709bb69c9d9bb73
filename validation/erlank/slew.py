"""Slew test of CubeStar: attitudes, modes and measured rates as a function of the commanded rate (Erlank 2013 §6.2,
Fig. 6.5)."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from gss.domain.angles import Array
from gss.domain.camera import Camera
from gss.domain.experiment import Cell, Experiment, Progress, share_text
from gss.domain.results import Attitude, Verdict
from gss.domain.rotation import rotation_from_vector
from gss.domain.stars import StarTable
from gss.instruments.registry import shipped_camera
from gss.pipeline.chains.cubestar import CubestarParameters, default_parameters, next_mode, solve
from gss.pipeline.chains.modes import AttitudePrior, Mode
from gss.pipeline.rates import rate_between
from gss.pipeline.render import render
from gss.pipeline.score import assess
from gss.skytables.bank import OnboardCatalogue
from validation.erlank.sky import BANK_MAG, bank_of, in_view, random_attitude

# Rates in °/s: slowest rate of the telescope, rate of a nadir-pointing satellite, second rate of the telescope, rates
# up to and beyond the limit of 0.3°, third rate of the telescope.
RATES_DEG_S = (0.00833, 0.0635, 0.1333, 0.2, 0.25, 0.29, 0.35, 2.0)
PAPER = {
    0.0635: "least required",
    0.1333: "tracks, most stars matched",
    0.29: "limit 0.3",
    0.35: "beyond the limit",
    2.0: "no match, streaks",
}
ACROSS, ABOUT = "across", "about"
FRAMES, FRAME_S, EXPOSURE_S = 20, 1.0, 0.5
# Minimum number of stars in the paper (§6.1), which also selected its fields.
MIN_STARS = 8
SKY_MAG = 6.5


@dataclass
class _Slew:
    """Results of all frames at one rate. ``error_deg_s``: measured minus commanded rate per axis. ``sigmas``:
    ``error_deg_s`` divided by its σ."""

    frames: int = 0
    solved: int = 0
    tracking_frames: int = 0
    tracked: int = 0
    wrong: int = 0
    matched: list[int] = field(default_factory=list)
    error_deg_s: list[Array] = field(default_factory=list)
    speed_deg_s: list[float] = field(default_factory=list)
    sigmas: list[Array] = field(default_factory=list)


def erlank_6_2(
    stars: StarTable, trials: int, seed: int, progress: Progress, rates_deg_s: tuple[float, ...] = RATES_DEG_S
) -> Experiment:
    """Simulate slews across and about the boresight. ``trials``: runs of 20 frames per rate and axis."""
    rows: list[tuple[Cell, ...]] = []
    for k, rate_deg_s in enumerate(rates_deg_s):
        slews = {}
        for j, name in enumerate((ACROSS, ABOUT)):
            progress((k + j / 2) / len(rates_deg_s))
            slews[name] = _run(stars, rate_deg_s, name, trials, np.random.default_rng([seed, k, j]))
        rows += [_row(rate_deg_s, name, slew) for name, slew in slews.items()]
    progress(1.0)
    return Experiment(
        "erlank-6-2",
        "Tracking while slewing",
        "Erlank 2013 §6.2, Fig. 6.5, and §4.5",
        (
            "rate °/s, axis",
            "paper",
            "frames with an attitude (95 %)",
            "trackable frames tracked (95 %)",
            "mean stars matched",
            "mean rate measured, °/s",
            "σ across, °/s",
            "σ about, °/s",
            "error over predicted σ, rms",
            "wrong",
        ),
        tuple(rows),
        (
            f"{trials} runs of {FRAMES} frames at 1 Hz per rate and axis, {EXPOSURE_S} s of exposure with "
            f"rendered smear, stars to V {SKY_MAG}, noise and distortion; random attitudes with at least "
            f"{MIN_STARS} stars of the "
            "bank at the start",
            "across: rotation about any axis across the boresight; about: rotation about the boresight. Lost in "
            "space first, then tracking around the last attitude without a prediction (§4.5), and the previous "
            "mode if tracking fails",
            "rates are computed from the attitudes of consecutive frames; σ: rms of measured minus commanded "
            "rate, per axis",
        ),
        seed,
        (
            "For rotation across the boresight every star moves by the rate times one second. Above 0.3°/s no "
            "star is within the tracking radius, as the publication states. For rotation about the boresight a "
            "star moves in "
            "proportion to the sine of its distance from the centre, and tracking continues at higher rates.",
            "If tracking fails, the chain of GSS returns to the assisted mode around the last boresight, and the "
            "next frame has an attitude again. At 0.35°/s this is every second frame. The paper uses tracking "
            "only and states 0.3°/s as its limit.",
            "At 2°/s the smear of half a second is 18 px: faint stars are not detected, and bright stars are too "
            "large for valid regions. For rotation about the boresight, stars near it remain compact.",
        ),
    )


def _run(stars: StarTable, rate_deg_s: float, name: str, runs: int, rng: np.random.Generator) -> _Slew:
    profile = shipped_camera("cubestar")
    bank, sky, p = bank_of(stars, profile.camera), stars.brighter_than(SKY_MAG), default_parameters(profile, EXPOSURE_S)
    slew = _Slew()
    for _ in range(runs):
        bearing = 2 * np.pi * rng.random()
        axis = np.array([np.cos(bearing), np.sin(bearing), 0.0] if name == ACROSS else [0.0, 0.0, 1.0])
        _one(slew, sky, bank, p, np.radians(rate_deg_s) * axis, rng)
    return slew


def _one(
    slew: _Slew,
    sky: StarTable,
    bank: OnboardCatalogue,
    parameters: CubestarParameters,
    rate_rad_s: Array,
    rng: np.random.Generator,
) -> None:
    profile = shipped_camera("cubestar")
    truth, turn = _rich_field(sky, profile.camera, rng), rotation_from_vector(-FRAME_S * rate_rad_s)
    mode, hint, last = Mode.LOST_IN_SPACE, None, None
    for _ in range(FRAMES):
        frame = render(sky, profile.camera, profile.sensor, truth, EXPOSURE_S, rng, rate_rad_s=rate_rad_s)
        result = solve(frame.pixels, profile.camera, bank, parameters, mode=mode, hint=hint)
        attitude = result.attitude
        slew.frames += 1
        slew.solved += attitude is not None
        slew.tracking_frames += mode is Mode.TRACKING
        slew.tracked += mode is Mode.TRACKING and attitude is not None
        slew.wrong += assess(result, frame.truth, profile.camera).verdict is Verdict.WRONG
        if attitude is not None and result.matches is not None:
            slew.matched.append(len(result.matches))
            hint = AttitudePrior.from_quaternion(attitude.quaternion)
            if last is not None:
                _measure(slew, last, attitude, rate_rad_s)
        mode, last = next_mode(mode, attitude is not None), attitude
        truth = turn @ truth


def _rich_field(sky: StarTable, camera: Camera, rng: np.random.Generator) -> Array:
    """Return a random attitude with at least eight stars of the bank in the field of view."""
    while True:
        attitude = random_attitude(rng)
        if np.count_nonzero(in_view(sky, camera, attitude).v_mag <= BANK_MAG) >= MIN_STARS:
            return attitude


def _measure(slew: _Slew, first: Attitude, second: Attitude, rate_rad_s: Array) -> None:
    rate = rate_between(first, second, FRAME_S)
    error_rad_s = rate.vector_rad_s - rate_rad_s
    slew.error_deg_s.append(np.degrees(error_rad_s))
    slew.sigmas.append(error_rad_s / np.array(rate.sigma_rad_s))
    along = float(rate.vector_rad_s @ rate_rad_s / np.linalg.norm(rate_rad_s))
    slew.speed_deg_s.append(float(np.degrees(along)))


def _row(rate_deg_s: float, name: str, slew: _Slew) -> tuple[Cell, ...]:
    measured: tuple[Cell, ...] = (None, None, None, None)
    if slew.error_deg_s:
        square = np.mean(np.square(slew.error_deg_s), axis=0)
        half = 1.96 * float(np.std(slew.speed_deg_s)) / np.sqrt(len(slew.speed_deg_s))
        measured = (
            f"{np.mean(slew.speed_deg_s):.5f} ±{half:.5f}",
            round(float(np.sqrt((square[0] + square[1]) / 2)), 5),
            round(float(np.sqrt(square[2])), 5),
            round(float(np.sqrt(np.mean(np.square(slew.sigmas)))), 2),
        )
    return (
        f"{rate_deg_s:g}, {name}",
        PAPER.get(rate_deg_s, ""),
        share_text(slew.solved, slew.frames),
        share_text(slew.tracked, slew.tracking_frames),
        round(float(np.mean(slew.matched)), 1) if slew.matched else 0,
        *measured,
        slew.wrong,
    )
