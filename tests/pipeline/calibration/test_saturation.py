"""Saturated stars in frames with a bright sky."""

from __future__ import annotations

import numpy as np
import pytest

from gss.domain.camera import Camera
from gss.domain.results import Attitude, Matches, Outcome, SolveResult
from gss.domain.stars import StarTable
from gss.pipeline.calibration.photometric import calibrate_photometry
from gss.pipeline.calibration.sightings import FrameStars, frame_stars
from gss.pipeline.detect import find_stars

CAMERA = Camera.from_fov(400, 400, 0.2)
FULL_DN, PEAK_OF_V5_DN = 255, 100.0


def frame_with_sky(sky_dn: float, seed: int) -> tuple[FrameStars, list[int]]:
    """Return the stars of an 8-bit frame of 25 stars, and the brightest pixel of each."""
    rng = np.random.default_rng(seed)
    row, col = np.mgrid[:400, :400]
    image = sky_dn + rng.normal(0, 1.5, (400, 400))
    v_mag = rng.uniform(3, 7, 25)
    grid = 40 + 80 * np.stack(np.divmod(np.arange(25), 5), axis=1) + rng.uniform(-0.5, 0.5, (25, 2))
    for (x, y), v in zip(grid, v_mag, strict=True):
        image += PEAK_OF_V5_DN * 10 ** (-0.4 * (v - 5)) * np.exp(-((col - x) ** 2 + (row - y) ** 2) / 2)
    pixels = np.clip(np.rint(image), 0, FULL_DN).astype(np.uint8)
    detections = find_stars(pixels, psf_sigma_px=1.0, saturation_dn=float(FULL_DN), e_per_dn=10.0)
    found = detections.centroids
    star = np.linalg.norm(found.pixels[:, None] - grid, axis=2).argmin(axis=1)
    hip, zero = np.arange(25, dtype=np.int32), np.zeros(25)
    table = StarTable(
        hip, CAMERA.unproject(grid), v_mag, zero + 0.6, np.zeros((25, 3)), zero, np.zeros(25, np.uint16), 2000.0
    )
    ones, attitude = np.ones(len(star)), Attitude(np.array([0.0, 0.0, 0.0, 1.0]), np.eye(3) * 1e-12)
    matches = Matches(np.arange(len(star), dtype=np.int32), hip[star], ones, np.zeros((len(star), 2)))
    result = SolveResult("reference", Outcome.SOLVED, "", CAMERA, (), found, matches, attitude, 0.0)
    frame = frame_stars("frame", result, table, exposure_s=1.0, saturation_dn=float(FULL_DN), pixels=pixels)
    assert frame is not None
    nearest = np.rint(grid[star]).astype(int)
    return frame, [int(pixels[y - 1 : y + 2, x - 1 : x + 2].max()) for x, y in nearest]


@pytest.mark.parametrize("sky_dn", [5.0, 60.0, 120.0])
def test_clipped_stars_are_recognised_and_the_sky_reduces_the_range(sky_dn: float) -> None:
    """Every clipped star is excluded, and a star of the magnitude of saturation has a peak of the range above the sky."""
    frames = []
    for seed in range(4):
        frame, brightest = frame_with_sky(sky_dn, seed)
        assert frame.saturated.tolist() == [peak >= 0.98 * FULL_DN for peak in brightest]
        assert frame.saturated.any()
        frames.append(frame)
    calibration = calibrate_photometry(frames, CAMERA)
    assert not np.any(calibration.used & np.concatenate([f.saturated for f in frames]))
    assert calibration.saturation_dn == FULL_DN
    true_mag = 5 - 2.5 * np.log10((FULL_DN - sky_dn) / PEAK_OF_V5_DN)
    assert calibration.saturation_mag == pytest.approx(true_mag, abs=0.1)
