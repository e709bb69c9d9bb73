"""Plausibility tests of an identification in addition to its number of stars: separate stars, share of the stars,
handedness, size of the residuals.

Close companions match together, so they count as one star. A pattern that is its own mirror image also fits a mirrored
frame. The residuals of accidental matches fill the tolerance evenly instead of concentrating at zero.
"""

from __future__ import annotations

import numpy as np

from gss.domain.angles import Array, lengths
from gss.pipeline.kernels import kernels
from gss.pipeline.small import best_rotation

# Residuals that are distributed evenly over a disc of radius T have an rms of T/2 per axis. Residuals of real stars are
# far smaller.
EVEN_SHARE = 1 / 3
SIGMAS = 2.0
# Minimum share of the stars, and the share required if the bound on the false-match probability is above the limit. Accidental
# matches are more frequent than their bound if a mirrored frame is compared with a known attitude, because stars near the
# axis of the mirror image keep their places. In 30 000 mirrored or random lists, the reference chain found 133 accidental
# matches with a bound below 3e-2, six of them with more than three tenths of the stars and none with four tenths. Of 10 000
# correct attitudes of the on-board chains, 20 have too few stars by this test.
LEAST_SHARE, DOUBTFUL_SHARE, DOUBTFUL_PROBABILITY = 0.3, 0.4, 1e-6


def is_few(identified: int, possible: int, probability: float) -> bool:
    """True if an identification has too few of the ``possible`` stars for its bound on the false-match ``probability``.
    Possible are the centroids or the stars in the field, whichever are fewer."""
    share = LEAST_SHARE if probability <= DOUBTFUL_PROBABILITY else DOUBTFUL_SHARE
    return identified < share * possible


def separate_stars(unit: Array, radius_rad: float) -> int:
    """Return the number of (n, 3) directions that are further than ``radius_rad`` from every direction counted before."""
    apart = lengths(unit[:, None] - unit[None]) > radius_rad
    counted: list[int] = []
    for k, from_star in enumerate(apart.tolist()):
        if all(from_star[other] for other in counted):
            counted.append(k)
    return len(counted)


def is_handed(measured_cam: Array, reference_icrs: Array, tolerance_rad: float, *, fast: bool | None = None) -> bool:
    """True if the mirror image of the (n ≥ 2, 3) finite measured directions does not fit the stars within the tolerance.
    ``fast``: see :func:`gss.pipeline.kernels.kernels`."""
    loops = kernels(fast).lists
    miss_rad = _mirror_miss_rad if loops is None else loops.mirror_miss_rad
    return miss_rad(measured_cam, reference_icrs) > tolerance_rad


def _mirror_miss_rad(measured_cam: Array, reference_icrs: Array) -> float:
    """Return the largest distance of a star from its measured direction after the reflection and rotation that fit best."""
    opposite = best_rotation(-measured_cam, reference_icrs, np.ones(len(measured_cam)))
    return float(lengths(reference_icrs @ opposite.T + measured_cam).max())


def errors_objection(miss_rad: Array, sigma_rad: Array, tolerance_rad: float, pixel_rad: float) -> str:
    """Return why the (n,) residuals are too large to be measurement errors, or ""."""
    per_axis_rad = float(np.sqrt(np.mean(miss_rad**2) / 2))
    limit_rad = max(EVEN_SHARE * tolerance_rad, SIGMAS * float(np.sqrt(np.mean(sigma_rad**2))))
    if per_axis_rad <= limit_rad:
        return ""
    return (
        f"residuals of {per_axis_rad / pixel_rad:.2f} px rms, {limit_rad / pixel_rad:.2f} allowed: "
        "accidental, or another camera's geometry"
    )
