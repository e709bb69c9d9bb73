"""Pointing candidates from figures: matches with a dictionary level that are supported by other bright detections."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gss.domain.angles import Array
from gss.domain.camera import Camera
from gss.pipeline.identify.patterns import PatternLevel
from gss.pipeline.identify.verify import SkyCatalogue

CODE_RADIUS = 0.014
PROBES = 14


@dataclass(frozen=True)
class Candidate:
    camera: Camera
    cam_from_icrs: Array
    hits: int
    level: PatternLevel


def look_up(
    level: PatternLevel,
    codes: Array,
    ids: NDArray[np.int32],
    size: Array,
    camera: Camera,
    window: tuple[float, float],
    pixels: Array,
    sky: SkyCatalogue,
) -> tuple[list[Candidate], int]:
    """Return the candidates of one level that at least one more star supports, and the number of candidates before this test."""
    near = level.tree.query_ball_point(codes, CODE_RADIUS, return_sorted=False)
    count = np.fromiter((len(x) for x in near), np.intp, len(near))
    if not count.sum():
        return [], 0
    figure = np.repeat(np.arange(len(codes)), count)
    pattern = np.concatenate([np.asarray(x, np.intp) for x in near if x])
    # The focal length follows from the ratio of the sizes at the assumed focal length to the true sizes.
    factor = size[figure] / level.size_rad[pattern]
    low, high = (np.tan(camera.fov_rad[0] / 2) / np.tan(w / 2) for w in (window[1], window[0]))
    ok = (factor > low) & (factor < high)
    figure, pattern, factor = figure[ok], pattern[ok], factor[ok]
    if not len(figure):
        return [], 0
    out = []
    for start in range(0, len(figure), 512):
        part = slice(start, start + 512)
        out += _probe(level, ids[figure[part]], pattern[part], factor[part], camera, pixels, sky)
    return out, len(figure)


def _probe(
    level: PatternLevel,
    ids: NDArray[np.int32],
    pattern: NDArray[np.intp],
    factor: Array,
    camera: Camera,
    pixels: Array,
    sky: SkyCatalogue,
) -> list[Candidate]:
    """Map the other bright detections to the sky with each candidate's attitude and count those that coincide with a star."""
    c = len(ids)
    probes = pixels[: min(PROBES, len(pixels))]
    focal = np.array([camera.focal_col_px, camera.focal_row_px]) * factor[:, None]
    centre = np.array([camera.centre_col_px, camera.centre_row_px])

    def rays(points: Array) -> Array:
        xy = (points - centre) / focal[:, None, :]
        v = np.concatenate([xy, np.ones((*xy.shape[:-1], 1))], axis=-1)
        return np.asarray(v / np.linalg.norm(v, axis=-1, keepdims=True))

    observed, reference = rays(pixels[ids]), sky.icrs[level.stars[pattern]]
    u, _, vt = np.linalg.svd(np.einsum("cki,ckj->cij", observed, reference))
    sign = np.sign(np.linalg.det(u) * np.linalg.det(vt))
    u[:, :, 2] *= sign[:, None]
    rotation = u @ vt
    probe_icrs = np.einsum("cji,ckj->cki", rotation, rays(np.broadcast_to(probes, (c, *probes.shape))))
    reach = 0.008 * camera.columns / focal[:, 0]
    distance, _ = level.bright.query(probe_icrs.reshape(-1, 3), distance_upper_bound=float(reach.max()))
    hit = distance.reshape(c, -1) < reach[:, None]
    in_pattern = (ids[:, :, None] == np.arange(len(probes))).any(1)
    hits = (hit & ~in_pattern).sum(1)
    free = (~in_pattern).sum(1)
    need = np.where(free <= 4, 1, 2)
    return [
        Candidate(camera.with_focal_scaled(float(factor[k])), rotation[k], int(hits[k]), level)
        for k in np.flatnonzero(hits >= need)
    ]
