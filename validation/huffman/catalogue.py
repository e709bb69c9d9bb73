"""Reruns of Huffman's catalogue tables with Hipparcos: limiting magnitudes for a number of stars, and the reduced
catalogue."""

from __future__ import annotations

import numpy as np

from gss.catalogue_tools.envelope.field import CircularField, FieldShape
from gss.catalogue_tools.selection.uniform_density import reduce_catalogue, square_field, survey_attitudes
from gss.catalogue_tools.sources.hipparcos import FAINTEST_V_MAG
from gss.domain.angles import Array
from gss.domain.experiment import Cell, Experiment, Progress, share_text
from gss.domain.rotation import matrix_from_quaternion
from gss.domain.stars import StarTable
from gss.instruments.registry import shipped_camera
from gss.skytables.pairs import distance_table
from gss.skytables.sin2 import sin2_directory

# Table 5.1: field of view in degrees, limiting magnitudes for at least four and six stars.
PAPER_5_1 = ((25, 3.9, 4.3), (30, 3.6, 3.9), (35, 3.4, 3.6), (40, 3.3, 3.4), (45, 3.1, 3.3))
SURVEY_MAG = 6.0
BRIGHTEST = 8
SURVEY_STEP_RAD = float(np.radians(1.0))
# Fields for the reduced catalogue; the document states 540 stars but no field.
REDUCED_SQUARES_DEG = (25, 30, 36, 40, 45)
PAPER_REDUCED = (5060, 540)
# Bytes of a pair in the directory: two rows, sin²θ, and an entry in the k-vector.
PAIR_BYTES = 2 * 2 + 4 + 4


def huffman_5_1(stars: StarTable, trials: int, seed: int, progress: Progress) -> Experiment:
    """Compute the limiting magnitudes at which a field contains at least four and six stars (Huffman 2006 §5.1,
    Table 5.1). ``trials``: number of random pointings."""
    bright = stars.brighter_than(min(SURVEY_MAG, FAINTEST_V_MAG))
    attitudes = _random_attitudes(trials, seed)
    rows: list[tuple[Cell, ...]] = []
    for k, (fov_deg, *limits) in enumerate(PAPER_5_1):
        progress(k / len(PAPER_5_1))
        for name, shape in _shapes(fov_deg):
            nth = nth_brightest_mag(bright, shape, attitudes, 6)
            for count, paper in zip((4, 6), limits, strict=True):
                needed = nth[:, count - 1]
                median, p95, worst = np.quantile(needed, [0.5, 0.95, 1.0])
                share = share_text(int(np.count_nonzero(needed <= paper)), trials)
                label = f"{fov_deg}° {name}, at least {count} stars"
                rows.append((label, paper, *(round(float(x), 2) for x in (median, p95, worst)), share))
    progress(1.0)
    return Experiment(
        "huffman-5-1",
        "Limiting magnitude for a number of stars",
        "Huffman 2006 §5.1, Table 5.1",
        (
            "field",
            "paper V",
            "ours, half the sky",
            "ours, 95 %",
            "ours, everywhere",
            "sky with enough stars at the paper's V",
        ),
        tuple(rows),
        (
            f"{trials} pointings, uniform over the sphere and the roll",
            f"Hipparcos V ≤ {SURVEY_MAG:g}, no doubles merged",
        ),
        seed,
        (
            "The paper seems to state a limit for every pointing, but its magnitudes give this number of stars "
            "in only 64 to 92 % of the sky. It does not state whether its field is a circle or a square.",
        ),
    )


def huffman_5_5(
    stars: StarTable, trials: int, seed: int, progress: Progress, step_rad: float = SURVEY_STEP_RAD
) -> Experiment:
    """Build the reduced catalogue and its pair directory (Huffman 2006 §5.5.4).

    ``trials``: number of random pointings that measure the coverage of the camera's frame. ``step_rad``: distance
    between the pointings of the survey.
    """
    bright = stars.brighter_than(SURVEY_MAG)
    camera = shipped_camera("far_mst").camera
    survey, probes = survey_attitudes(step_rad), _random_attitudes(trials, seed)
    shapes = [(f"{deg}° square", square_field(float(np.radians(deg)))) for deg in REDUCED_SQUARES_DEG]
    shapes.append(("frame 30.06° x 24.25°", FieldShape(camera)))
    rows: list[tuple[Cell, ...]] = []
    for k, (label, shape) in enumerate(shapes):
        progress(k / len(shapes))
        reduced = bright.take(reduce_catalogue(bright, shape, survey, BRIGHTEST).kept)
        nth = nth_brightest_mag(reduced, FieldShape(camera), probes, 5)
        pairs = len(sin2_directory(distance_table(reduced, 0.0, camera.diagonal_rad), len(reduced)))
        fewer = (int(np.count_nonzero(~np.isfinite(nth[:, n]))) for n in (3, 4))
        paper = PAPER_REDUCED[1] if label.startswith("36") else None
        rows.append((label, paper, len(reduced), *(share_text(f, trials) for f in fewer), pairs, pairs * PAIR_BYTES))
    progress(1.0)
    return Experiment(
        "huffman-5-5",
        "Reduced catalogue: the eight brightest of every field",
        "Huffman 2006 §5.5.4",
        (
            "field",
            "paper stars",
            "our stars",
            "frames with fewer than 4 stars",
            "frames with fewer than 5",
            "pairs to 37.95°",
            "directory bytes",
        ),
        tuple(rows),
        (
            f"{len(bright)} stars V ≤ {SURVEY_MAG:g} (paper {PAPER_REDUCED[0]})",
            f"{len(survey)} north-up pointings {np.degrees(step_rad):g}° apart",
            f"coverage of the 30.06° x 24.25° frame over {trials} random attitudes",
        ),
        seed,
        (
            "The paper's 540 stars result for a field of about 36°, which is wider than its camera's frame. "
            "With 540 stars some frames have too few stars.",
        ),
    )


def nth_brightest_mag(stars: StarTable, shape: FieldShape | CircularField, attitudes: Array, count: int) -> Array:
    """Return the (m, count) magnitudes of the brightest, second brightest … star in each field; infinite if the field
    has fewer stars."""
    order = np.argsort(stars.v_mag, kind="stable")
    unit, v_mag = stars.icrs[order], np.append(stars.v_mag[order], np.inf)
    rows = np.full((len(attitudes), count), len(unit))
    for k, rotation in enumerate(attitudes):
        near = np.flatnonzero(unit @ rotation[2] >= np.cos(shape.half_diagonal_rad))
        inside = near[shape.inside(unit[near] @ rotation.T)][:count]
        rows[k, : len(inside)] = inside
    return np.asarray(v_mag[rows])


def _shapes(fov_deg: float) -> tuple[tuple[str, FieldShape | CircularField], ...]:
    side_rad = float(np.radians(fov_deg))
    return ("square", square_field(side_rad)), ("circle", CircularField(side_rad / 2))


def _random_attitudes(count: int, seed: int) -> Array:
    q = np.random.default_rng(seed).normal(size=(count, 4))
    return matrix_from_quaternion(q)
