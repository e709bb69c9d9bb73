"""Connected groups of pixels above the noise in a frame with masked stars."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from gss.domain.angles import Array

GROUP_SIGMA = 3.0
"""Level above which pixels form a group, in standard deviations of the filtered frame."""
PEAK_SIGMA = 5.0
SUM_SIGMA = 8.0
"""Minimum total significance of a group whose peak is lower than ``PEAK_SIGMA``, for example a faint streak."""
MAX_GROUPS = 60


@dataclass(frozen=True)
class PixelGroup:
    """Connected group of pixels above the threshold. ``col``, ``row``: centre; ``trail`` (2,): initial estimate of the
    vector from one end of the trail to the other, px; ``flux_dn``: initial estimate of the flux."""

    col: int
    row: int
    trail: Array
    flux_dn: float


def pixel_groups(
    image: NDArray[np.float32], mask: NDArray[np.bool_], noise: float, variance: float
) -> list[PixelGroup]:
    """Return up to ``MAX_GROUPS`` groups, the most significant one first. ``mask``: True for pixels to ignore;
    ``noise``: standard deviation of a pixel, DN; ``variance``: of the point-spread function, px²."""
    sigma = float(np.sqrt(variance))
    smooth = ndimage.gaussian_filter(image, sigma, mode="nearest")
    # The noise is measured on the filtered frame, because the noise of neighbouring pixels is correlated on some
    # detectors.
    sample = smooth[::3, ::3][~mask[::3, ::3]]
    middle = float(np.median(sample)) if len(sample) else 0.0
    spread = 1.4826 * float(np.median(np.abs(sample - middle))) if len(sample) else noise
    spread = max(spread, noise / (2 * np.sqrt(np.pi) * sigma) / 2)
    significance = (smooth - middle) / spread
    significance[mask] = 0.0
    labels, count = ndimage.label(significance > GROUP_SIGMA, np.ones((3, 3)))
    groups: list[tuple[float, PixelGroup]] = []
    for label, box in enumerate(ndimage.find_objects(labels, count), 1):
        inside = labels[box] == label
        weight = np.where(inside, significance[box], 0.0)
        total = float(weight.sum())
        # The filter correlates the noise of about 4πσ² neighbouring pixels.
        total_snr = total / np.sqrt(inside.sum() * 4 * np.pi * variance)
        if weight.max() < PEAK_SIGMA and total_snr < SUM_SIGMA:
            continue
        row, col = np.nonzero(inside)
        w = weight[row, col] / total
        x, y = float(w @ col), float(w @ row)
        moments = np.cov(np.stack([col, row]).astype(float), aweights=w, bias=True) if len(row) > 2 else np.eye(2) * 0.1
        values, vectors = np.linalg.eigh(moments)
        length = np.sqrt(max(12 * (values[1] - values[0]), 0.0))
        flux = float((image[box] * inside).sum())
        group = PixelGroup(
            round(x + box[1].start), round(y + box[0].start), vectors[:, 1] * length, max(flux, float(noise))
        )
        groups.append((max(float(weight.max()), total_snr), group))
    groups.sort(key=lambda m: -m[0])
    return [group for _, group in groups[:MAX_GROUPS]]
