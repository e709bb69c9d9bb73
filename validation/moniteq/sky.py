"""Reruns of Moniteq's star statistics and linked search on the real sky (Moniteq 1983 §2.1, §6.1)."""

from __future__ import annotations

from math import exp, factorial

import numpy as np

from gss.domain.experiment import Cell, Experiment, Progress, share_text
from gss.domain.rotation import matrix_from_quaternion, random_quaternion, rotation_from_vector
from gss.domain.stars import StarTable
from gss.pipeline.track.link_walk import walk
from gss.skytables.neighbours import neighbour_links

WHOLE_SKY_DEG2 = 41_253.0
# Table 2.1: faint end of each interval of V, number of stars in the interval.
PAPER_2_1 = (
    (-0.51, 2),
    (0.49, 7),
    (1.49, 13),
    (2.49, 71),
    (3.49, 192),
    (4.49, 625),
    (5.49, 1963),
    (6.49, 5606),
    (7.49, 15_565),
)
# Table 2.2: limit of V, field in square degrees, probability of 0 to 4 stars. The printed 0.982 is a misprint for 0.082.
PAPER_2_2 = (
    (5.5, 10, (0.498, 0.347, 0.121, 0.028, 0.005)),
    (5.5, 36, (0.082, 0.204, 0.256, 0.214, 0.134)),
    (5.5, 64, (0.012, 0.052, 0.115, 0.171, 0.191)),
    (5.5, 100, (0.001, 0.007, 0.023, 0.053, 0.093)),
    (6.5, 10, (0.128, 0.263, 0.270, 0.185, 0.095)),
    (6.5, 36, (0.0006, 0.005, 0.017, 0.041, 0.076)),
)
AIM_FIELD_DEG2 = 11.9
LINKED_STARS, PAPER_CHECKS = 3000, 120


def moniteq_2_1(stars: StarTable, trials: int, seed: int, progress: Progress) -> Experiment:
    """Count stars by magnitude and per field, and compare Poisson's law with random fields. ``trials``: fields per
    row."""
    rows: list[tuple[Cell, ...]] = []
    before, total = -9.0, 0
    for faint, count in PAPER_2_1:
        total += count
        ours = int(np.count_nonzero((stars.v_mag > before) & (stars.v_mag <= faint)))
        rows.append((f"V to {faint}", count, ours, None, None))
        before = faint
    bright = float(np.count_nonzero(stars.v_mag <= before))
    rows.append(("all to V 7.49", total, int(bright), None, None))
    rng = np.random.default_rng(seed)
    centres = matrix_from_quaternion(rng.normal(size=(trials, 4)))[:, 2]
    cells: list[tuple[float, float, tuple[float, ...], bool]] = [
        (v, area, paper, False) for v, area, paper in PAPER_2_2
    ]
    cells += [(limit, AIM_FIELD_DEG2, (), True) for limit in (5.5, 6.0, 6.5, 7.5)]
    for k, (limit, area, paper, aim) in enumerate(cells):
        progress(k / len(cells))
        bright_stars = stars.icrs[stars.v_mag <= limit]
        counts = _counts(bright_stars, centres, 1 - area * (np.pi / 180) ** 2 / (2 * np.pi))
        mean = len(bright_stars) * area / WHOLE_SKY_DEG2
        if aim:
            enough, many = int(np.count_nonzero(counts >= 3)), 1 - sum(_poisson(mean, n) for n in range(3))
            rows.append(
                (f"V {limit}, 3.45° field: ≥ 3 stars", None, share_text(enough, trials), f"{100 * many:.1f} %", None)
            )
            continue
        for n, printed in enumerate(paper):
            hits = int(np.count_nonzero(counts == n))
            law, off = f"{100 * _poisson(mean, n):.1f} %", f"{100 * (hits / trials - printed):+.1f} %"
            rows.append(
                (f"V {limit}, {area:g} deg²: {n} stars", f"{100 * printed:g} %", share_text(hits, trials), law, off)
            )
    progress(1.0)
    return Experiment(
        "moniteq-2-1",
        "Stars by magnitude and in a field",
        "Moniteq 1983 Tables 2.1 and 2.2",
        ("quantity", "paper", "ours (95 %)", "Poisson with our counts", "ours minus paper"),
        tuple(rows),
        (f"{trials} random circular fields per row, Hipparcos V; counts of stars and shares of fields",),
        seed,
        (
            "Hipparcos is complete to about V 7.3 and has close doubles as one entry; SKYMAP's counts are those of "
            "1982.",
            "The star density is higher towards the Milky Way. Therefore fields with few stars and fields with "
            "many stars are both more frequent than in a Poisson distribution.",
            "The report requires three stars for a reliable identification and does not state how often its field "
            "contains them.",
            "Table 2.2 prints .982 for no star in 36 square degrees at V 5.5. This is a misprint for .082, which Poisson's law "
            "gives. Its rows for V 6.5 with 64 and 100 square degrees are omitted: all their probabilities are below 0.3 %.",
        ),
    )


def _counts(unit: np.ndarray, centres: np.ndarray, cosine: float) -> np.ndarray:
    """Return the (trials,) number of stars within the circle around each centre."""
    parts = [np.count_nonzero(centres[k : k + 500] @ unit.T >= cosine, axis=1) for k in range(0, len(centres), 500)]
    return np.concatenate(parts)


def _poisson(mean: float, n: int) -> float:
    return exp(-mean) * mean**n / factorial(n)


def moniteq_links(stars: StarTable, trials: int, seed: int, progress: Progress) -> Experiment:
    """Compare the number of stars that a search along the links examines with the size of the whole list. ``trials``:
    random fields per row."""
    brightest = stars.brighter_than(float(np.sort(stars.v_mag)[LINKED_STARS - 1]))
    icrs = brightest.icrs[:LINKED_STARS]
    links = neighbour_links(icrs)
    rows: list[tuple[Cell, ...]] = []
    # A circle of 4.7° contains five of the 3000 stars. The enlarged field of the document's example contains 45 or
    # more.
    for k, (shift_deg, radius_deg) in enumerate(((0.1, 4.68), (1.0, 4.68), (3.0, 4.68), (1.0, 14.05))):
        checks, missed, expected_total = [], 0, 0
        for trial in range(trials):
            progress((k + trial / trials) / 4)
            rng = np.random.default_rng([seed, k, trial])
            frame = matrix_from_quaternion(random_quaternion(rng))
            start = np.flatnonzero(icrs @ frame[2] >= np.cos(np.radians(4.68)))
            if not len(start):
                continue
            centre = rotation_from_vector(np.radians(shift_deg) * frame[0]) @ frame[2]
            visited = walk(links, icrs, start, centre, np.radians(radius_deg))
            in_field = np.flatnonzero(icrs @ centre >= np.cos(np.radians(radius_deg)))
            checks.append(visited.checks)
            expected_total += len(in_field)
            missed += len(np.setdiff1d(in_field, visited.rows))
        mean = float(np.mean(checks)) if checks else float("nan")
        half = 1.96 * float(np.std(checks)) / np.sqrt(max(len(checks), 1))
        paper = PAPER_CHECKS if radius_deg > 10 else None
        ours = f"{mean:.0f} ({mean - half:.0f}–{mean + half:.0f}, n {len(checks)})"
        rows.append(
            (f"shift {shift_deg}°, {expected_total / max(len(checks), 1):.0f} stars", paper, ours, LINKED_STARS, missed)
        )
    progress(1.0)
    return Experiment(
        "moniteq-links",
        "Following links against searching the list",
        "Moniteq 1983 §6.1",
        ("new field", "paper: links checked", "ours: stars examined (95 %)", "linear search", "stars missed"),
        tuple(rows),
        (f"{trials} random fields per row; {LINKED_STARS} brightest stars, {links.links} links (3n − 6)",),
        seed,
        (
            "The document counts the links between 45 stars without the links between the 5 stars at the start: "
            "129 − 9 = 120. GSS counts each examined star once, including stars just outside the field.",
        ),
    )
