"""Area and polar moment of spherical and planar star triangles (Huffman 2006 §5.4.2, eqs. 5.4 to 5.15)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gss.domain.angles import Array
from gss.domain.camera import Camera
from gss.domain.experiment import Cell, Experiment, Progress, share_text
from gss.domain.stars import StarTable
from gss.instruments.registry import shipped_camera

LIMIT_MAG, SIGMA_PX, DEPTH, MEASUREMENTS = 4.0, 0.3, 2, 100
THREE_SIGMA, PAPER_WITHIN = 3.0, 99.7
PROPERTIES = ("spherical area", "spherical moment", "planar area", "planar moment")


def sides(corners: Array) -> Array:
    """Return the (n, 3) arcs between the (n, 3, 3) corners of triangles, radians."""
    chord = np.linalg.norm(corners - np.roll(corners, -1, axis=1), axis=2)
    return np.asarray(2 * np.arcsin(np.clip(chord / 2, 0, 1)))


def spherical_area(corners: Array) -> Array:
    """Return the (n,) areas of spherical triangles in steradians (eq. 5.4)."""
    arcs = sides(corners)
    half = arcs.sum(axis=1) / 2
    product = np.tan(half / 2) * np.prod(np.tan((half[:, None] - arcs) / 2), axis=1)
    return np.asarray(4 * np.arctan(np.sqrt(np.maximum(product, 0))))


def spherical_moment(corners: Array, depth: int = DEPTH) -> Array:
    """Return the (n,) polar moments of spherical triangles, divided ``depth`` times into four (eq. 5.9)."""
    centre = _unit(corners.sum(axis=1))
    parts = corners[:, None]
    for _ in range(depth):
        a, b, c = parts[:, :, 0], parts[:, :, 1], parts[:, :, 2]
        ab, bc, ca = _unit(a + b), _unit(b + c), _unit(c + a)
        quarters = ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))
        parts = np.concatenate([np.stack(q, axis=2) for q in quarters], axis=1)
    middle = _unit(parts.sum(axis=2))
    theta = 2 * np.arcsin(np.clip(np.linalg.norm(middle - centre[:, None], axis=2) / 2, 0, 1))
    area = spherical_area(parts.reshape(-1, 3, 3)).reshape(theta.shape)
    return np.asarray((theta**2 * area).sum(axis=1))


def planar_area(corners: Array) -> Array:
    """Return the (n,) areas of the planar triangles between the ends of the unit vectors (eq. 5.10)."""
    edges = np.linalg.norm(corners - np.roll(corners, -1, axis=1), axis=2)
    half = edges.sum(axis=1) / 2
    return np.asarray(np.sqrt(np.maximum(half * np.prod(half[:, None] - edges, axis=1), 0)))


def planar_moment(corners: Array) -> Array:
    """Return the (n,) polar moments of planar triangles (eq. 5.15 with the planar area)."""
    edges = np.linalg.norm(corners - np.roll(corners, -1, axis=1), axis=2)
    return np.asarray(planar_area(corners) * (edges**2).sum(axis=1) / 36)


def huffman_5_4(stars: StarTable, trials: int, seed: int, progress: Progress) -> Experiment:
    """Measure triangles of stars with errors and count the catalogue's triangles that agree. ``trials``: number of triangles."""
    camera, catalogue = shipped_camera("far_mst").camera, stars.brighter_than(LIMIT_MAG).icrs
    triangles = _triangles(catalogue, camera)
    known = _properties(catalogue[triangles])
    pair_rad = np.sort(sides(catalogue[_pairs(catalogue, camera)])[:, 0])
    rng = np.random.default_rng(seed)
    sigma_rad = SIGMA_PX * camera.pixel_rad
    within, candidates = np.zeros(4, int), np.zeros((3, trials))
    for k, row in enumerate(rng.integers(0, len(triangles), trials)):
        progress(k / trials)
        true = catalogue[triangles[row]]
        measured = _unit(true + sigma_rad * rng.normal(size=(MEASUREMENTS, 3, 3)))
        values = _properties(measured)
        spread = values.std(axis=1)
        off = np.abs(values - known[:, row, None])
        within += (off <= THREE_SIGMA * spread[:, None]).sum(axis=1)
        agrees = np.abs(known - values[:, :1]) <= THREE_SIGMA * spread[:, None]
        arc = sides(measured[:1])[0, 0]
        tolerance = THREE_SIGMA * sigma_rad * np.sqrt(2)
        candidates[0, k] = np.searchsorted(pair_rad, arc + tolerance) - np.searchsorted(pair_rad, arc - tolerance)
        candidates[1, k] = np.count_nonzero(agrees[0] & agrees[1])
        candidates[2, k] = np.count_nonzero(agrees[2] & agrees[3])
    progress(1.0)
    measured_count = trials * MEASUREMENTS
    rows: list[tuple[Cell, ...]] = [
        (
            f"{name}: within 3 σ",
            PAPER_WITHIN if name == "spherical moment" else None,
            share_text(int(n), measured_count),
        )
        for name, n in zip(PROPERTIES, within, strict=True)
    ]
    means = candidates.mean(axis=1)
    rows += [
        ("pairs that agree with an angle, mean", None, f"{means[0]:.1f} of {len(pair_rad)}"),
        ("triangles that agree in spherical area and moment, mean", None, f"{means[1]:.1f} of {len(triangles)}"),
        ("triangles that agree in planar area and moment, mean", None, f"{means[2]:.1f} of {len(triangles)}"),
        ("planar against spherical moment, median relative difference", None, f"{_difference(known):.2%}"),
    ]
    return Experiment(
        "huffman-5-4",
        "Area and polar moment of star triangles",
        "Huffman 2006 §5.4.2, eqs. 5.4 to 5.15",
        ("quantity", "paper, %", "ours (95 %)"),
        tuple(rows),
        (
            f"{trials} random triangles of {len(triangles)} with {MEASUREMENTS} measurements each (document: 1000 and 100); "
            f"Hipparcos V ≤ {LIMIT_MAG:g}, triangles whose sides fit into half the frame's height",
            f"error of a star {SIGMA_PX:g} px per axis; σ is that of the measurements of the triangle; moment: "
            f"{4**DEPTH} parts of a triangle",
        ),
        seed,
        (
            "Three standard deviations contain 99.7 % of the measurements, as the document states for the spherical moment.",
            "A triangle is described by two numbers, area and moment; a pair is described by one angle. Far fewer "
            "triangles agree by chance, so fewer pivots are needed. The document states a third of the pivots of the "
            "angle method; pivots are not computed here.",
            f"Eq. 5.9 omits the moment of each part about the centre of the part. With {4**DEPTH} parts the spherical moment is "
            f"{1 / 4**DEPTH:.0%} too small.",
            "Eq. 5.15 prints the spherical area A_ST in the planar moment. GSS uses the planar area. The chain does not use "
            "these properties, because n-vertex figures use every angle (§5.5.4).",
        ),
    )


def _unit(v: Array) -> Array:
    return np.asarray(v / np.linalg.norm(v, axis=-1, keepdims=True))


def _properties(corners: Array) -> Array:
    """Return the (4, n) properties in the order of ``PROPERTIES``."""
    return np.stack([spherical_area(corners), spherical_moment(corners), planar_area(corners), planar_moment(corners)])


def _pairs(catalogue: Array, camera: Camera) -> NDArray[np.intp]:
    """Return the (n, 2) pairs of stars no further apart than half the frame's height."""
    near = catalogue @ catalogue.T >= np.cos(camera.fov_rad[1] / 2)
    return np.argwhere(np.triu(near, 1))


def _triangles(catalogue: Array, camera: Camera) -> NDArray[np.intp]:
    """Return the (n, 3) triangles whose sides are no longer than half the frame's height."""
    pairs = _pairs(catalogue, camera)
    near = np.zeros((len(catalogue), len(catalogue)), bool)
    near[pairs[:, 0], pairs[:, 1]] = True
    pair, third = np.nonzero(near[pairs[:, 0]] & near[pairs[:, 1]])
    return np.column_stack([pairs[pair], third])


def _difference(known: Array) -> float:
    return float(np.median(np.abs(known[3] / known[1] - 1)))
