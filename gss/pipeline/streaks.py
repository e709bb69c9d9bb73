"""Camera rotation during an exposure: one angular velocity fitted to the trails of all stars.

If the camera rotates with ω, the direction u moves with −ω × u in its frame; the trail of a star in pixels is therefore
d = T M(u) ω with the known (2, 3) matrix M at its position. Each trail is a Gaussian extended along d; positions,
fluxes and the frame's common ω and width are fitted together to the pixels. A trail does not show the direction of
motion, so −ω fits as well as ω.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gss.domain.angles import Array
from gss.domain.camera import Camera
from gss.domain.results import Centroids, Turning
from gss.pipeline.background import Background
from gss.pipeline.kernels import kernels
from gss.pipeline.psf import cut_stamps
from gss.pipeline.trail_shape import trailed_gaussian

MAX_TRAILS = 24
PROMISING = 2
UNLIKE = 1.5
MAX_ALIKE = 0.6
MAX_EXCESS = 4.0
BRIGHT_SIGMA = 3.0
MIN_TRAILS = 4
MAX_HALF_PX = 40
FIT_ROUNDS = 20
DONE = 0.01  # convergence limit of a step, in standard deviations
STEP_RAD = 1e-5
MIN_SIGNIFICANT = 25.0  # improvement in χ² of trails over untrailed stars required to report a rate
PIXEL_VARIANCE_PX2 = 1 / 12
LEAST_FLUX = 1e-3  # lower limit of a fitted flux, as a share of the sum of the absolute pixels


@dataclass(frozen=True)
class Trails:
    """Input of the fit for n trails: (n, k) pixels above the sky and a mask of the pixels used, (k,) offsets from the
    centres (n,), variance of a sky pixel (n,), and trail (n, 2, 3) in px per radian of rotation."""

    value: Array
    use: NDArray[np.bool_]
    dx: Array
    dy: Array
    col: Array
    row: Array
    sky_variance: Array
    per_rad: Array

    def take(self, mask: NDArray[np.bool_]) -> Trails:
        """Return the trails selected by a mask."""
        return Trails(
            self.value[mask],
            self.use[mask],
            self.dx,
            self.dy,
            self.col[mask],
            self.row[mask],
            self.sky_variance[mask],
            self.per_rad[mask],
        )


@dataclass(frozen=True)
class FitSums:
    """Sums of a step of the fit, for n trails of k pixels. ``model``: (n, k) pixels at the best fluxes; ``variance``: (n, k)
    predicted by the model. ``products``: (n, 7, 7) weighted sums of products of the derivatives with respect to flux, x, y,
    the three rotations, and the width; ``pulls``: (n, 7) of the derivatives and the residuals."""

    model: Array
    chi2: float
    variance: Array
    products: Array
    pulls: Array


def measure_turning(
    image: NDArray[Any],
    centroids: Centroids,
    background: Background,
    camera: Camera,
    exposure_s: float,
    covariance_px2: Array,
    *,
    psf_sigma_px: float | None = None,
    e_per_dn: float = 0.0,
    saturation_dn: float = float("inf"),
    fast: bool | None = None,
) -> Turning | None:
    """Measure the angular velocity from a (rows, columns) frame; None if no trail is significant.

    ``covariance_px2``: (2, 2) of the frame's typical spot, trail included. ``psf_sigma_px``: width of an untrailed
    star, if known; it is the starting value of the fitted width. ``fast``: see :func:`gss.pipeline.kernels.kernels`.
    """
    trails = _cut(image, centroids, background, camera, covariance_px2, saturation_dn)
    if trails is None:
        return None
    frames = kernels(fast).frames
    sums: Sums = partial(frames.trail_sums if frames else fit_sums, e_per_dn=e_per_dn)
    width2 = PIXEL_VARIANCE_PX2 + (psf_sigma_px**2 if psf_sigma_px else max(_narrow2(covariance_px2), 0.3))
    best = _best(trails, _starts(trails, width2), width2, sums)
    consistent = _consistent(trails, best, sums)
    if int(consistent.sum()) < max(MIN_TRAILS, MAX_ALIKE * len(consistent)):
        return None  # the elongated spots are not trails of one common rotation
    if not consistent.all():
        trails = trails.take(consistent)
        best = _best(trails, [best.turned_rad], best.width2, sums)
    untrailed = _fit(trails, np.zeros(3), width2, sums, turn=False)
    freedom = int(trails.use.sum()) - 3 * len(trails.value) - 4
    longest_px = float(np.linalg.norm(trails.per_rad @ best.turned_rad, axis=1).max())
    if freedom <= 0 or not np.isfinite(best.covariance).all() or longest_px > 2 * trails.dx.max():
        return None
    excess = max(best.chi2 / freedom, 1.0)
    if excess > MAX_EXCESS or (untrailed.chi2 - best.chi2) / excess < MIN_SIGNIFICANT:
        return None
    rotation_rad, covariance = best.turned_rad, best.covariance[:3, :3] * excess
    largest = int(np.argmax(np.abs(rotation_rad)))
    if rotation_rad[largest] < 0:
        rotation_rad = -rotation_rad
    return Turning(rotation_rad / exposure_s, covariance / exposure_s**2, len(trails.value))


def with_sign_of(turning: Turning, vector_rad_s: Array) -> Turning:
    """Return the rate with the sign of another measurement of the same rate, which resolves the ± ambiguity."""
    sign = -1.0 if float(turning.vector_rad_s @ np.asarray(vector_rad_s)) < 0 else 1.0
    return Turning(sign * turning.vector_rad_s, turning.covariance_rad2_s2, turning.stars, True)


def trail_per_rad(camera: Camera, pixels: Array) -> Array:
    """Return the (n, 2, 3) displacements of stars at (n, 2) pixels, in px per radian of camera rotation about x, y, z."""
    unit = camera.unproject(pixels)
    columns = []
    for axis in np.eye(3):
        moved = np.cross(axis, unit) * STEP_RAD
        columns.append((camera.project(unit - moved) - camera.project(unit + moved)) / (2 * STEP_RAD))
    return np.stack(columns, axis=-1)


def _narrow2(covariance: Array) -> float:
    return float(np.linalg.eigvalsh(covariance)[0]) - PIXEL_VARIANCE_PX2


def _cut(
    image: NDArray[Any],
    centroids: Centroids,
    background: Background,
    camera: Camera,
    covariance: Array,
    saturation_dn: float,
) -> Trails | None:
    """Cut out the brightest stars whose trails are complete, unsaturated and isolated; None if there are too few."""
    longest = float(np.sqrt(np.linalg.eigvalsh(covariance)[1]))
    half = int(min(np.ceil(2.6 * longest) + 3, MAX_HALF_PX))
    col, row = np.rint(centroids.col_px).astype(np.intp), np.rint(centroids.row_px).astype(np.intp)
    complete = (col >= half) & (row >= half) & (col < image.shape[1] - half) & (row < image.shape[0] - half)
    distance_px = np.maximum(np.abs(col[:, None] - col), np.abs(row[:, None] - row))
    rivals = (distance_px <= 1.6 * half) & (centroids.flux_dn > 0.05 * centroids.flux_dn[:, None])
    np.fill_diagonal(rivals, False)
    isolated = ~rivals.any(axis=1)
    good = np.flatnonzero(complete & isolated & (centroids.peak_dn > 0))[:MAX_TRAILS]
    if len(good) < MIN_TRAILS:
        return None
    sky, noise = background.at(col[good], row[good])
    stamps = cut_stamps(image, col[good], row[good], sky, half, saturation_dn)
    unclipped = stamps.use.all(axis=1)
    significant = stamps.value.sum(axis=1) > 6 * noise * half
    keep = unclipped & significant
    good = good[keep]
    per_rad = trail_per_rad(camera, centroids.pixels[good])
    finite = np.isfinite(per_rad).all(axis=(1, 2))
    if int(finite.sum()) < MIN_TRAILS:
        return None
    rows = np.flatnonzero(keep)[finite]
    return Trails(
        stamps.value[rows],
        stamps.use[rows],
        stamps.dx,
        stamps.dy,
        centroids.col_px[good[finite]] - col[good[finite]],
        centroids.row_px[good[finite]] - row[good[finite]],
        noise[rows] ** 2,
        per_rad[finite],
    )


def _starts(trails: Trails, width2: float) -> list[Array]:
    """Return first guesses of the rotation in rad, computed from second moments, with both signs of the roll relative
    to the cross-axis rotation."""
    weight = np.where(trails.value > BRIGHT_SIGMA * np.sqrt(trails.sky_variance)[:, None], trails.value, 0.0)
    weight[:, (trails.dx == 0) & (trails.dy == 0)] += 1e-6
    total = weight.sum(1)
    ax, ay = trails.dx - trails.col[:, None], trails.dy - trails.row[:, None]
    moments = np.stack([(weight * p).sum(1) / total for p in (ax * ax, ay * ay, ax * ay)], axis=1)
    moments[:, :2] = np.maximum(moments[:, :2] - width2, 0.0)
    # The second moments are linear functions of the six products of the components of the rotation.
    m = trails.per_rad / np.sqrt(12)
    pairs = [(0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)]
    rows = []
    for a, b in ((0, 0), (1, 1), (0, 1)):
        rows.append(
            np.stack([m[:, a, i] * m[:, b, j] + (m[:, a, j] * m[:, b, i] if i != j else 0) for i, j in pairs], axis=1)
        )
    system = np.concatenate(rows)
    products, *_ = np.linalg.lstsq(system, moments.T.ravel(), rcond=None)
    matrix = np.zeros((3, 3))
    for (i, j), value in zip(pairs, products, strict=True):
        matrix[i, j] = matrix[j, i] = value
    values, vectors = np.linalg.eigh(matrix)
    first = np.sqrt(max(values[-1], 0.0)) * vectors[:, -1]
    smallest = 1.0 / float(np.abs(trails.per_rad).max())
    if np.linalg.norm(first) < smallest:
        first = np.array([smallest, smallest, 0.0])
    across = np.array([*np.sqrt(np.maximum(np.diag(matrix)[:2], smallest**2)), np.sqrt(max(matrix[2, 2], 0.0))])
    excess = float(np.median(moments[:, 0] + moments[:, 1]))
    roll = np.sqrt(12 * excess / max(float(np.median((trails.per_rad[:, :, 2] ** 2).sum(1))), 1e-12))
    starts = [np.array([0.0, 0.0, roll]), np.array([0.0, 0.0, 2 * roll])] + [
        first * [1, 1, k] for k in (1, -1, 0, 3, -3)
    ]
    starts += [across * [a, 1, k] for a in (1, -1) for k in (1, -1, 0)]
    return [np.asarray(start, float) for start in starts]


def _best(trails: Trails, starts: list[Array], width2: float, sums: Sums) -> _Fitted:
    """Return the best fit from the first guess (pure roll) and from the ``PROMISING`` other guesses with the lowest χ²."""
    variance = np.broadcast_to(trails.sky_variance[:, None], trails.value.shape)
    start_chi2 = [sums(trails, start, width2, trails.col, trails.row, variance).chi2 for start in starts]
    chosen = [0, *(int(k) + 1 for k in np.argsort(start_chi2[1:])[:PROMISING])]
    fits = [_fit(trails, starts[k], width2, sums, turn=True) for k in chosen]
    return min(fits, key=lambda f: f.chi2)


def _consistent(trails: Trails, fit: _Fitted, sums: Sums) -> NDArray[np.bool_]:
    """True for trails that the common rotation fits as well as it fits the median trail. Trails with a neighbour or
    defect and trails of planets fit worse."""
    variance = np.broadcast_to(trails.sky_variance[:, None], trails.value.shape)
    for _ in range(2):
        at = sums(trails, fit.turned_rad, fit.width2, fit.x, fit.y, variance)
        variance = at.variance
    misfit = (trails.use * (trails.value - at.model) ** 2 / variance).sum(1) / np.maximum(trails.use.sum(1), 1)
    return np.asarray(misfit < UNLIKE * max(float(np.median(misfit)), 1.0))


@dataclass(frozen=True)
class _Fitted:
    """Result of a fit: rotation, χ², covariance of rotation and width, width, and the centres of the trails."""

    turned_rad: Array
    chi2: float
    covariance: Array
    width2: float
    x: Array
    y: Array


def _fit(trails: Trails, turned: Array, width2: float, sums: Sums, *, turn: bool) -> _Fitted:
    """Fit the common rotation and width by Levenberg–Marquardt. The position and flux of each trail are eliminated star by star."""
    x, y, w2 = trails.col.copy(), trails.row.copy(), width2
    shared = 4 if turn else 1
    variance = np.broadcast_to(trails.sky_variance[:, None], trails.value.shape)
    damping, before = 1e-3, np.inf
    terms = (turned, w2, x, y)
    normal = np.eye(shared)
    step_size = np.inf
    for _ in range(FIT_ROUNDS):
        at = sums(trails, turned, w2, x, y, variance)
        if at.chi2 > before * (1 + 1e-12) and np.isfinite(before):
            damping *= 10
            turned, w2, x, y = terms
            if damping > 1e6:
                break
            at = sums(trails, turned, w2, x, y, variance)
        else:
            damping = max(damping / 10, 1e-9)
        if step_size < DONE and np.isfinite(before):
            break
        before, terms = at.chi2, (turned, w2, x, y)
        own, common = slice(3), slice(3 if turn else 6, 7)
        a, b = at.products[:, own, own], at.products[:, own, common]
        c = at.products[:, common, common].sum(axis=0)
        p, q = at.pulls[:, own], at.pulls[:, common].sum(axis=0)
        a = a + 1e-12 * np.trace(a, axis1=1, axis2=2)[:, None, None] * np.eye(3)
        solved, own_step = np.linalg.solve(a, b), np.linalg.solve(a, p[..., None])
        normal = c - np.einsum("nij,nik->jk", b, solved)
        gradient = q - np.einsum("nij,ni->j", b, own_step[..., 0])
        step = np.linalg.solve(normal + damping * np.diag(np.diag(normal)) + 1e-300 * np.eye(shared), gradient)
        own_moved = own_step[..., 0] - np.einsum("nij,j->ni", solved, step)
        x, y = x + np.clip(own_moved[:, 1], -0.5, 0.5), y + np.clip(own_moved[:, 2], -0.5, 0.5)
        if turn:
            turned = turned + step[:3]
        w2 = float(np.clip(w2 + step[-1], 0.6 * w2, 1.6 * w2))
        step_size = float(np.max(np.abs(step) * np.sqrt(np.maximum(np.diag(normal), 0.0))))
        variance = at.variance
    turned, w2, x, y = terms
    with np.errstate(all="ignore"):
        try:
            covariance: Array = np.asarray(np.linalg.inv(normal), float)
        except np.linalg.LinAlgError:
            covariance = np.full((shared, shared), np.inf)
    return _Fitted(turned, float(min(before, at.chi2)), covariance, w2, x, y)


def fit_sums(
    trails: Trails, turned: Array, width2: float, x: Array, y: Array, variance: Array, e_per_dn: float
) -> FitSums:
    """Return the sums of a step. ``turned``: (3,) rotation in rad; ``x``, ``y``: (n,) centres in px; ``variance``: (n, k) of
    the pixels."""
    trail = trails.per_rad @ turned
    shape, derivatives = trailed_gaussian(trails.dx - x[:, None], trails.dy - y[:, None], trail, width2)
    weight = trails.use / variance
    flux = (weight * shape * trails.value).sum(1) / np.maximum((weight * shape * shape).sum(1), 1e-300)
    flux = np.maximum(flux, LEAST_FLUX * np.abs(trails.value).sum(1))
    model = flux[:, None] * shape
    slopes = np.empty((*shape.shape, 7))
    slopes[..., 0] = shape
    slopes[..., 1:3] = -flux[:, None, None] * derivatives[..., :2]
    slopes[..., 3:6] = flux[:, None, None] * (derivatives[..., 2:4] @ trails.per_rad)
    slopes[..., 6] = flux[:, None] * derivatives[..., 4]
    weighted_residual = weight * (trails.value - model)
    expected = trails.sky_variance[:, None] + (np.maximum(model, 0) / e_per_dn if e_per_dn > 0 else 0.0)
    return FitSums(
        model,
        float((weighted_residual * (trails.value - model)).sum()),
        np.broadcast_to(expected, model.shape),
        (slopes * weight[..., None]).swapaxes(1, 2) @ slopes,
        (weighted_residual[:, None, :] @ slopes)[:, 0],
    )


Sums = Callable[[Trails, Array, float, Array, Array, Array], FitSums]
"""``fit_sums``, or its compiled equivalent, with the number of electrons per DN."""
