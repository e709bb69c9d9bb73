"""Selection of the parameters that the stars determine. Other parameters are fixed at their values and listed."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from gss.domain.angles import Array
from gss.pipeline.calibration.bundle import Adjusted, Prior, adjust
from gss.pipeline.calibration.lens_models import FREEZING_ORDER, TILT, Vector, most_allowed_sigma
from gss.pipeline.calibration.result import Frozen
from gss.pipeline.calibration.star_stack import StarStack

TWINS = 0.998  # correlation above which two parameters cannot be separated
TWIN_GROUPS = ({"centre_col_px", "centre_row_px"}, {"p1", "p2", *TILT})


def hold_unsupported(
    stars: StarStack, vector: Vector, turns: Array, priors: Mapping[str, Prior]
) -> tuple[Adjusted, tuple[Frozen, ...]]:
    """Fit the camera. While parameters are undetermined or almost fully correlated, fix the first of them in the
    freezing order and fit again. A parameter with a prior narrower than the limit is always determined."""
    frozen: list[Frozen] = []
    start = vector
    vector = _within_equations(stars, vector, frozen)
    while True:
        fit = adjust(stars, vector, turns, priors)
        unsupported, reason = _worst(fit)
        if not unsupported:
            return fit, tuple(frozen)
        frozen += [Frozen(n, start.values[n], reason, _sigma(fit, n)) for n in unsupported]
        vector = _restarted(start, fit.vector).without(unsupported)


def _sigma(fit: Adjusted, name: str) -> float:
    """Return the standard deviation of a free parameter in its unit."""
    index = fit.vector.free.index(name)
    scale = fit.vector.values[name] if name in ("focal_px", "aspect") else 1.0
    return scale * float(np.sqrt(max(fit.covariance[index, index], 0.0)))


def _restarted(start: Vector, fitted: Vector) -> Vector:
    """Return the initial values as the new start, because the values fitted along an undetermined direction are a poor
    start."""
    return start.without(tuple(n for n in start.free if n not in fitted.free))


def _within_equations(stars: StarStack, vector: Vector, frozen: list[Frozen]) -> Vector:
    """Fix parameters until there are fewer unknowns than equations."""
    for group in FREEZING_ORDER:
        if 2 * len(stars) - 3 * stars.frames > len(vector.free):
            break
        group_names = tuple(n for n in group if n in vector.free)
        frozen += [Frozen(n, vector.values[n], "fewer equations than unknowns", float("nan")) for n in group_names]
        vector = vector.without(group_names)
    return vector


def _worst(fit: Adjusted) -> tuple[tuple[str, ...], str]:
    free = fit.vector.free
    if not free:
        return (), ""
    sigma = np.sqrt(np.maximum(np.diag(fit.covariance), 0))
    limit = most_allowed_sigma(fit.vector)
    loose = {n for n, s, max_sigma in zip(free, sigma, limit, strict=True) if not s <= max_sigma}
    twins = _twins(fit, sigma)
    for group in FREEZING_ORDER:
        fitted = tuple(n for n in group if n in free)
        if loose & set(fitted):
            worst = max((n for n in fitted if n in loose), key=lambda n: sigma[free.index(n)] / limit[free.index(n)])
            return fitted, f"its σ would be {sigma[free.index(worst)]:.2g}"
        if twins & set(fitted):
            return fitted, "cannot be separated from another parameter"
    return (), ""


def _twins(fit: Adjusted, sigma: Array) -> set[str]:
    """Return the tangential coefficients or tilts that are almost fully correlated with the centre."""
    free = fit.vector.free
    correlation = fit.covariance / np.maximum(np.outer(sigma, sigma), 1e-300)
    twins = set()
    for i, a in enumerate(free):
        for j, b in enumerate(free):
            if a in TWIN_GROUPS[1] and b in TWIN_GROUPS[0] and abs(correlation[i, j]) > TWINS:
                twins.add(a)
    return twins
