"""Best-case accuracy of CubeStar: all stages process noise-free artificial images (Erlank 2013 §4.4, Figs. 4.4 and
4.5)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from gss.domain.angles import Array
from gss.domain.experiment import Cell, Experiment, Progress, share_text
from gss.domain.results import Verdict
from gss.domain.stars import StarTable
from gss.instruments.registry import shipped_camera
from gss.pipeline.chains.cubestar import solve
from gss.pipeline.chains.cubestar_parameters import CubestarParameters
from gss.pipeline.render import render
from gss.pipeline.score import assess
from validation.erlank.matching import Bench, bench
from validation.erlank.sky import BANK_MAG, Drawing, in_view, random_attitude, star_image

PAPER_CROSS_DEG, PAPER_ABOUT_DEG = 0.004, 0.02
# With this low threshold, all pixels of the 5 x 5 grid belong to the star, as in the first row of the rerun of §4.1.6.
LOW_THRESHOLD_DN = 1.0

Draw = Callable[[Array, np.random.Generator], NDArray[np.uint8]]


@dataclass
class _Errors:
    cross_deg: list[float] = field(default_factory=list)
    about_deg: list[float] = field(default_factory=list)
    wrong: int = 0


def erlank_4_4b(stars: StarTable, trials: int, seed: int, progress: Progress) -> Experiment:
    """Measure the largest errors across and about the boresight. ``trials``: images per drawing method; the paper has 100."""
    setup, bright = bench(stars), stars.brighter_than(BANK_MAG)
    low = replace(setup.parameters, threshold_dn=LOW_THRESHOLD_DN)
    cases = (
        ("drawn as §4.1.6, threshold 1", low, _drawn(bright, setup, Drawing())),
        ("grid on the pixel before in y, threshold 1", low, _drawn(bright, setup, Drawing(floor_row=True))),
        ("drawn as §4.1.6, our threshold", setup.parameters, _drawn(bright, setup, Drawing())),
        ("our renderer, brightness by magnitude", setup.parameters, _rendered(bright, setup)),
    )
    rows: list[tuple[Cell, ...]] = []
    for k, (title, p, draw) in enumerate(cases):
        progress(k / len(cases))
        rows.append(_row(title, _errors(setup, p, bright, draw, trials, np.random.default_rng([seed, k])), trials))
    progress(1.0)
    return Experiment(
        "erlank-4-4b",
        "Best-case accuracy of the attitude",
        "Erlank 2013 §4.4, Figs. 4.4 and 4.5",
        (
            "images",
            "paper largest cross, °",
            "ours largest",
            "ours median",
            "within the paper's (95 %)",
            "paper largest about, °",
            "ours largest ",
            "ours median ",
            "within the paper's (95 %) ",
            "solved (95 %)",
            "wrong",
        ),
        tuple(rows),
        (
            f"{trials} random attitudes per row, lost in space, stars to V {BANK_MAG}, 54° x 28.6°, no noise, no distortion",
            "errors relative to the attitude used for the drawing; the share is that of solved images",
        ),
        seed,
        (
            "The paper's figures are maxima over 100 images, read from plots. A maximum grows with the number of "
            "images and depends on fields with four stars close together.",
            "Only systematic errors of the centroids remain. They depend on the rendering (see erlank-4-1-6): a "
            "grid that is off centre in y shifts every star, and therefore the boresight, in the same direction.",
        ),
    )


def _drawn(stars: StarTable, setup: Bench, drawing: Drawing) -> Draw:
    return lambda attitude, _: star_image(in_view(stars, setup.camera, attitude).pixels, setup.camera, drawing)


def _rendered(stars: StarTable, setup: Bench) -> Draw:
    own = shipped_camera("cubestar").sensor
    quiet = replace(own, read_noise_e=0.0, dark_current_e_s=0.0, background_e_s=0.0)

    def draw(attitude: Array, rng: np.random.Generator) -> NDArray[np.uint8]:
        frame = render(stars, setup.camera, quiet, attitude, own.exposure_s, rng, noise=False)
        return np.asarray(frame.pixels, np.uint8)

    return draw


def _errors(
    setup: Bench, parameters: CubestarParameters, stars: StarTable, draw: Draw, trials: int, rng: np.random.Generator
) -> _Errors:
    errors = _Errors()
    for _ in range(trials):
        attitude = random_attitude(rng)
        result = solve(draw(attitude, rng), setup.camera, setup.bank, parameters)
        scored = assess(result, in_view(stars, setup.camera, attitude), setup.camera)
        if scored.verdict is not Verdict.NONE:
            errors.cross_deg.append(float(np.degrees(scored.cross_rad)))
            errors.about_deg.append(float(np.degrees(abs(scored.about_rad))))
        errors.wrong += scored.verdict is Verdict.WRONG
    return errors


def _row(title: str, e: _Errors, trials: int) -> tuple[Cell, ...]:
    cells: list[Cell] = [title]
    for paper, ours in ((PAPER_CROSS_DEG, e.cross_deg), (PAPER_ABOUT_DEG, e.about_deg)):
        errors = np.array(ours) if ours else np.array([np.nan])
        inside = int(np.count_nonzero(errors <= paper))
        cells += [
            paper,
            round(float(errors.max()), 5) if ours else None,
            round(float(np.median(errors)), 5) if ours else None,
            share_text(inside, len(ours)),
        ]
    return (*cells, share_text(len(e.cross_deg), trials), e.wrong)
