"""Success of geometric voting as a function of the magnitude cutoff and of the number of false stars (Erlank 2013
§4.3.5, Tables 4.4 and 4.5)."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from gss.domain.angles import Array
from gss.domain.camera import Camera
from gss.domain.experiment import Cell, Experiment, Progress, share_text
from gss.domain.results import Centroids, Truth, Verdict
from gss.domain.stars import StarTable
from gss.pipeline.chains.cubestar import solve_centroids
from gss.pipeline.chains.cubestar_parameters import CubestarParameters
from gss.pipeline.chains.modes import AttitudePrior, Mode
from gss.pipeline.score import assess
from gss.skytables.bank import OnboardCatalogue
from validation.erlank.sky import (
    BANK_MAG,
    HINT_ERROR_RAD,
    bank_of,
    document_rows,
    in_view,
    random_attitude,
    rough_hint,
    simulated_camera,
    simulated_parameters,
)

LOST, ASSISTED, PERFECT = "lost in space", "assisted ±5°", "assisted perfect"
TESTED_MODES = (LOST, ASSISTED, PERFECT)
# Table 4.4: for each cutoff, (% of stars matched, % of images with more than two matches) in the three modes.
TABLE_4_4 = {
    3.6: ((75.45, 80.0), (84.7, 89.0), (88.21, 93.0)),
    3.7: ((85.2, 92.0), (86.62, 94.0), (90.76, 96.0)),
    3.8: ((84.01, 93.0), (89.62, 98.5), (91.84, 98.5)),
}
# Table 4.5: by number of false stars, % for lost in space and assisted.
TABLE_4_5 = {1: (79, 96), 5: (72, 96), 10: (58, 94)}
ENOUGH = 3
# Centroid error per axis in §4.1.6, and the centroid error for which the distance tolerance is 2.4 σ.
FINE_PX, COARSE_PX = 0.035, 0.3
TRIES = ("document", "document, 0.3 px", "document, 2 x tolerance", "chain")


@dataclass
class Tally:
    """Results of one matching method. ``shares``: percentage of correct stars per image. ``enough``, ``false_names``,
    ``wrong``: number of images with three correct stars, with a false match, and with a wrong attitude."""

    shares: list[float] = field(default_factory=list)
    enough: int = 0
    false_names: int = 0
    wrong: int = 0

    def stars_text(self) -> str:
        """Return the mean share of stars with its 95 % interval."""
        shares = 100 * np.array(self.shares)
        return f"{shares.mean():.1f} % (±{1.96 * shares.std() / np.sqrt(len(shares)):.1f})"

    def enough_text(self) -> str:
        """Return the share of images with at least three stars."""
        return share_text(self.enough, len(self.shares))


@dataclass(frozen=True)
class Bench:
    """Camera, parameters and bank used for all images."""

    camera: Camera
    parameters: CubestarParameters
    bank: OnboardCatalogue


def bench(stars: StarTable) -> Bench:
    """Return the camera of the artificial images with the whole bank."""
    camera = simulated_camera()
    return Bench(camera, simulated_parameters(), bank_of(stars, camera))


def erlank_4_4(stars: StarTable, trials: int, seed: int, progress: Progress) -> Experiment:
    """Measure the effect of the magnitude cutoff. ``trials``: images per cutoff and mode; the paper has 100."""
    setup = bench(stars)
    rows: list[tuple[Cell, ...]] = []
    for k, (cutoff, papers) in enumerate(TABLE_4_4.items()):
        for mode, (paper_stars, paper_enough) in zip(TESTED_MODES, papers, strict=True):
            progress((k + TESTED_MODES.index(mode) / 3) / len(TABLE_4_4))
            tallies = run(setup, stars.brighter_than(cutoff), mode, 0, trials, np.random.default_rng([seed, k]))
            texts = [tallies[name] for name in TRIES]
            named = "/".join(str(t.false_names) for t in texts[:3])
            rows += [
                (
                    f"V {cutoff}, {mode}: stars matched",
                    f"{paper_stars} %",
                    *(t.stars_text() for t in texts),
                    named,
                    None,
                ),
                (
                    f"V {cutoff}, {mode}: images with more than two",
                    f"{paper_enough:g} %",
                    *(t.enough_text() for t in texts),
                    named,
                    tallies["chain"].wrong,
                ),
            ]
    progress(1.0)
    return Experiment(
        "erlank-4-4",
        "Matching against magnitude cutoff",
        "Erlank 2013 §4.3.5, Table 4.4",
        COLUMNS,
        tuple(rows),
        (f"{trials} random attitudes per cutoff, the same in all modes", *_conditions(setup)),
        seed,
        NOTES,
    )


def erlank_4_5(stars: StarTable, trials: int, seed: int, progress: Progress) -> Experiment:
    """Measure the effect of false stars. ``trials``: images per number of false stars; the paper has 100."""
    setup = bench(stars)
    rows: list[tuple[Cell, ...]] = []
    for k, (false, papers) in enumerate(TABLE_4_5.items()):
        for mode, paper in zip((LOST, ASSISTED), papers, strict=True):
            progress((k + (mode == ASSISTED) / 2) / len(TABLE_4_5))
            rng = np.random.default_rng([seed, 100 + k])
            tallies = run(setup, stars.brighter_than(BANK_MAG), mode, false, trials, rng)
            texts = [tallies[name] for name in TRIES]
            named = "/".join(str(t.false_names) for t in texts[:3])
            rows.append(
                (
                    f"{false} false, {mode}: images with more than two",
                    f"{paper} %",
                    *(t.enough_text() for t in texts),
                    named,
                    tallies["chain"].wrong,
                )
            )
    progress(1.0)
    return Experiment(
        "erlank-4-5",
        "Matching among false stars",
        "Erlank 2013 §4.3.5, Table 4.5",
        COLUMNS,
        tuple(rows),
        (
            f"{trials} random attitudes per number, stars to V {BANK_MAG}, the same in both modes; false stars "
            f"uniform over the image, V 2 to {BANK_MAG}",
            *_conditions(setup),
        ),
        seed,
        NOTES,
    )


COLUMNS = (
    "quantity",
    "paper",
    "ours, document's acceptance (95 %)",
    f"with {COARSE_PX} px of error",
    "with twice its tolerance",
    "our chain (95 %)",
    "images with a false match: published acceptance, with 0.3 px, with twice its tolerance",
    "false attitudes: chain",
)
NOTES = (
    "Lost in space, the published acceptance gives better results here than in the paper, and with twice the "
    "tolerance similar results. An uncertainty of 0.001 rad for each star of a pair, instead of for the pair, "
    "would explain the figures of the paper.",
    "In assisted mode the paper identifies 85 to 92 % of the stars even with a perfect hint, although few stars are "
    "ambiguous. No error or tolerance tested here reproduces this, and the publication has no further details. A "
    "table of 11 486 pairs instead of the larger table of GSS changes the result by less than 2 %.",
    "The paper reports no false match. In GSS the same acceptance gives a false match in a few per cent of the "
    "images: close neighbours of the true star, and accidental pairs in images with few stars, are within one "
    "vote of the maximum.",
    "Therefore the chain of GSS requires that all matches agree with each other, at least four stars without a "
    "prior and three with a prior, and a false-match bound. So it identifies fewer stars. It uses the twenty "
    "brightest centroids, as the firmware does (§5.3.4).",
)


def _conditions(setup: Bench) -> tuple[str, ...]:
    return (
        f"bank V ≤ {BANK_MAG}: {len(setup.bank)} stars, {len(setup.bank.distances)} pairs up to the field's diagonal "
        "(paper 405, 11 486)",
        f"54° x 28.6°, no distortion, tolerance 0.001 rad (one pixel), centroids with {FINE_PX} px of error per "
        "axis; assisted mode: within 35° of the hint",
    )


def run(
    setup: Bench, seen: StarTable, mode: str, false: int, trials: int, rng: np.random.Generator
) -> dict[str, Tally]:
    """Run each matching method on the same images."""
    tallies = {name: Tally() for name in TRIES}
    for _ in range(trials):
        attitude = random_attitude(rng)
        truth = in_view(seen, setup.camera, attitude)
        error = rng.normal(size=truth.pixels.shape)
        spurious = rng.uniform((-0.5, -0.5), (setup.camera.columns - 0.5, setup.camera.rows - 0.5), (false, 2))
        spurious_mag = rng.uniform(2.0, BANK_MAG, false)
        hint = rough_hint(attitude, HINT_ERROR_RAD if mode == ASSISTED else 0.0, rng)
        prior = None if mode == LOST else hint
        for name, sigma_px, factor in (
            ("document", FINE_PX, 1.0),
            ("document, 0.3 px", COARSE_PX, 1.0),
            ("document, 2 x tolerance", FINE_PX, 2.0),
        ):
            pixels = np.vstack([truth.pixels + sigma_px * error, spurious])
            _count_document(tallies[name], setup, pixels, truth, prior, factor)
        order = np.argsort(np.concatenate([truth.v_mag, spurious_mag]), kind="stable")
        pixels = np.vstack([truth.pixels + FINE_PX * error, spurious])[order]
        flux = 10 ** (-0.4 * np.concatenate([truth.v_mag, spurious_mag])[order])
        _count_chain(tallies["chain"], setup, Centroids.from_pixels(pixels, flux, FINE_PX), truth, prior)
    return tallies


def _count_document(
    tally: Tally, setup: Bench, pixels: Array, truth: Truth, hint: AttitudePrior | None, factor: float
) -> None:
    row = document_rows(setup.camera.unproject(pixels), setup.bank, hint, factor * setup.parameters.tolerance_rad)
    hip = np.where(row >= 0, setup.bank.hip[row], -1)
    n = len(truth.hip)
    correct = int(np.count_nonzero(hip[:n] == truth.hip))
    tally.shares.append(correct / n if n else 0.0)
    tally.enough += correct >= ENOUGH
    tally.false_names += bool(np.count_nonzero(row >= 0) > correct)


def _count_chain(tally: Tally, setup: Bench, centroids: Centroids, truth: Truth, hint: AttitudePrior | None) -> None:
    mode = Mode.LOST_IN_SPACE if hint is None else Mode.ASSISTED
    result = solve_centroids(centroids, setup.camera, setup.bank, setup.parameters, mode=mode, hint=hint)
    scored = assess(result, truth, setup.camera)
    correct = scored.matched if result.attitude is not None else 0
    tally.shares.append(correct / len(truth.hip) if len(truth.hip) else 0.0)
    tally.enough += correct >= ENOUGH and scored.verdict is not Verdict.WRONG
    tally.wrong += scored.verdict is Verdict.WRONG
