"""Cross-validation of a calibration with frames that were not used for it."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from gss.pipeline.calibration.bundle import Adjusted, Prior, adjust
from gss.pipeline.calibration.residual_figures import ResidualFigures, residual_figures
from gss.pipeline.calibration.star_stack import StarStack

ROUNDS = 8
MIN_FRAMES = 3


def held_out(stars: StarStack, fit: Adjusted, priors: Mapping[str, Prior], folds: int) -> ResidualFigures | None:
    """Cross-validate by frame: fit the camera to the other frames, then only the attitude of each held-out frame.
    Residuals are corrected for the degrees of freedom of the attitude and are therefore comparable with the scatter of
    a star. Return None with fewer than three frames."""
    if stars.frames < MIN_FRAMES or folds < 2:
        return None
    count = min(folds, stars.frames)
    fold = np.arange(stars.frames) % count
    residual, used = np.zeros_like(stars.pixels), np.zeros(len(stars), bool)
    for k in range(count):
        training, out = fold != k, fold == k
        trained = adjust(
            stars.of_frames(training),
            fit.vector,
            fit.cam_from_icrs[training],
            priors,
            rounds=ROUNDS,
            used=fit.used[training[stars.frame]],
        )
        mask = out[stars.frame]
        held_out_stars = stars.of_frames(out)
        alone = adjust(
            held_out_stars,
            trained.vector.without(trained.vector.free),
            fit.cam_from_icrs[out],
            rounds=ROUNDS,
            used=fit.used[mask],
        )
        frame_stars = np.bincount(held_out_stars.frame[fit.used[mask]], minlength=held_out_stars.frames)
        # With two stars, the fit of the attitude leaves no degrees of freedom.
        stretch = np.sqrt(2 * frame_stars / np.maximum(2 * frame_stars - 3, 1))
        residual[mask] = alone.residual_px * stretch[held_out_stars.frame, None]
        used[mask] = fit.used[mask] & (frame_stars > MIN_FRAMES)[held_out_stars.frame]
    return residual_figures(residual, stars.sigma_px, used)
