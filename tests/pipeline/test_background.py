"""The mesh of sky level and noise, compared with simulated frames."""

from __future__ import annotations

import numpy as np

from gss.pipeline.background import measure_background, pixel_noise


def test_level_and_noise_of_a_flat_noisy_frame() -> None:
    """The level of a flat noisy frame is measured within a tenth of the noise, and the noise within a twentieth."""
    rng = np.random.default_rng(1)
    frame = rng.normal(100, 4, (256, 512)).astype(np.float32)
    background = measure_background(frame)
    assert np.abs(background.level - 100).max() < 0.4
    assert abs(float(np.median(background.noise)) - 4) < 0.2
    assert abs(pixel_noise(frame, background) - 4) < 0.2


def test_stars_and_hot_pixels_do_not_raise_the_level() -> None:
    """One pixel in fifty at full scale changes the level by less than half of the noise."""
    rng = np.random.default_rng(2)
    frame = rng.normal(30, 3, (256, 256))
    frame[rng.random(frame.shape) < 0.02] = 255
    background = measure_background(np.rint(frame).astype(np.uint8))
    assert np.abs(background.level - 30).max() < 1.5


def test_gradients_are_reproduced() -> None:
    """A ramp and a broad glow are reproduced within one and a half times the noise."""
    rng = np.random.default_rng(3)
    row, col = np.mgrid[:320, :480].astype(float)
    truth = 20 + 0.2 * col + 60 * np.exp(-((col - 300) ** 2 + (row - 150) ** 2) / (2 * 120**2))
    background = measure_background((truth + rng.normal(0, 3, truth.shape)).astype(np.float32))
    inner_row, inner_col = row[48:-48, 48:-48].ravel(), col[48:-48, 48:-48].ravel()
    level, _ = background.at(inner_col, inner_row)
    assert np.abs(level - truth[48:-48, 48:-48].ravel()).max() < 4.5


def test_any_frame_size_is_supported() -> None:
    """Frames with odd sizes, thin frames and constant frames give finite meshes."""
    for shape in ((33, 65), (8, 200), (507, 507), (9, 9)):
        background = measure_background(np.full(shape, 7, np.uint8))
        assert np.allclose(background.level, 7)
        assert (background.noise > 0).all()


def test_noise_of_a_coarsely_quantised_frame_is_not_zero() -> None:
    """A frame that contains only zeros and ones has a noise above zero, so that thresholds work."""
    frame = (np.random.default_rng(4).random((128, 128)) < 0.2).astype(np.uint8)
    assert 0.1 < pixel_noise(frame, measure_background(frame)) < 0.6
