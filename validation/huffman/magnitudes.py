"""Rerun of Huffman's study of magnitudes measured from frames (Huffman 2006 §5.3, Tables 5.2 and 5.3)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gss.domain.angles import Array
from gss.domain.experiment import Cell, Experiment, Progress
from gss.domain.stars import StarTable
from gss.pipeline.chains.far_mst_detect import find_centroids
from validation.huffman.frames import TABLE_5_2, frame, parameters, scattered

PAPER_5_3 = {0: (0.0309, 0.0427), 1: (0.0311, 0.0324), 2: (0.0353, 0.0419), 3: (0.0552, 0.0414), 4: (0.1362, 0.0685)}
KINDS = (("sliding", "weighted_sum"), ("block", "weighted_sum"), ("sliding", "mle"))
STARS = 20


def huffman_5_3(stars: StarTable, trials: int, seed: int, progress: Progress) -> Experiment:
    """Compare measured with true magnitudes. ``trials``: images of 20 stars per magnitude. The paper has 25 images in
    which all stars were detected."""
    rows: list[tuple[Cell, ...]] = []
    for v_mag, (mean, std) in PAPER_5_3.items():
        progress(v_mag / len(PAPER_5_3))
        deltas = _deltas(float(v_mag), trials, np.random.default_rng([seed, v_mag]))
        for (prefilter, centroider), delta in zip(KINDS, deltas, strict=True):
            n = delta.size
            ours: tuple[Cell, ...] = (None, "", None)
            if n:
                half = 1.96 * float(delta.std()) / np.sqrt(n)
                ours = (round(float(delta.mean()), 4), f"±{half:.4f}, n {n}", round(float(delta.std()), 4))
            rows.append((f"V {v_mag}, {prefilter}, {centroider.replace('_', ' ')}", mean, *ours[:2], std, ours[2]))
    progress(1.0)
    return Experiment(
        "huffman-5-3",
        "Magnitudes measured from frames",
        "Huffman 2006 §5.3, Tables 5.2 and 5.3",
        ("stars, filter, centroid", "paper mean ΔM", "our mean ΔM", "95 %", "paper σ", "our σ"),
        tuple(rows),
        (
            f"{trials} images of {STARS} equal stars per magnitude, 5 σ, PSF 10 px, g = 10, σ = 57 e (41 and 40 e), filters of 13",
            "only images in which all stars were detected count, as in the paper; no star within 30 px of the edge",
        ),
        seed,
        (
            "The deficit is light outside the cluster. The paper's values are between those of the two filters "
            "here; it does not state the limits of its filter. Its larger spread at the bright end agrees with "
            "stars cut by the edge of the image, which GSS excludes.",
            "Maximum likelihood measures the whole spot and has no deficit.",
        ),
    )


def _deltas(v_mag: float, images: int, rng: np.random.Generator) -> list[Array]:
    """Return, for each filter and centroid method, the measured minus true magnitudes of the images in which all stars
    were detected."""
    deltas: list[list[Array]] = [[] for _ in KINDS]
    for _ in range(images):
        at = scattered(STARS, rng, 60.0)
        image = frame(at, np.full(STARS, v_mag), TABLE_5_2, rng)
        for k, (prefilter, centroider) in enumerate(KINDS):
            chain_parameters = replace(parameters(TABLE_5_2, 5.0, prefilter), centroider=centroider)
            centroids = find_centroids(image, chain_parameters).centroids
            if len(centroids) == STARS:
                deltas[k].append(TABLE_5_2.magnitude(centroids.flux_dn) - v_mag)
    return [np.concatenate(k) if k else np.empty(0) for k in deltas]
