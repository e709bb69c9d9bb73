"""Detection of stars in frames, and rejection of spots that are not stars."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage
from scipy.special import erf

from gss.domain.angles import Array
from gss.domain.errors import BadInput
from gss.pipeline.detect import find_stars
from gss.pipeline.peaks import _filter_frame
from gss.pipeline.psf import NARROWEST_PX, widths_px

GAIN_E, READ_E, SKY_E, BIAS_DN = 40.0, 40.0, 80.0, 8.0


def expected_electrons(shape: tuple[int, int], xy: Array, flux_e: Array, sigma_px: float) -> Array:
    """Return the electrons of pixel-integrated Gaussian spots. Written independently of the renderer."""
    s = sigma_px * np.sqrt(2)
    light = np.zeros(shape)
    for (x, y), flux in zip(xy, flux_e, strict=True):
        gx = 0.5 * np.diff(erf((np.arange(shape[1] + 1) - 0.5 - x) / s))
        gy = 0.5 * np.diff(erf((np.arange(shape[0] + 1) - 0.5 - y) / s))
        light += flux * gy[:, None] * gx
    return light


def read_out(light_e: Array, rng: np.random.Generator) -> Array:
    """Return 8-bit values with shot noise, read noise and rounding."""
    electrons = rng.poisson(light_e + SKY_E) + rng.normal(0, READ_E, light_e.shape)
    return np.clip(np.rint(electrons / GAIN_E + BIAS_DN), 0, 255).astype(np.uint8)


def cramer_rao_px(shape: tuple[int, int], x: float, y: float, flux_e: float, sigma_px: float) -> float:
    """Return the lower bound of the error per axis, from the derivative of the expected pixels."""
    step_px = 1e-3
    one_star = np.array([flux_e])
    slope = (
        expected_electrons(shape, np.array([[x + step_px, y]]), one_star, sigma_px)
        - expected_electrons(shape, np.array([[x - step_px, y]]), one_star, sigma_px)
    ) / (2 * step_px)
    variance = expected_electrons(shape, np.array([[x, y]]), one_star, sigma_px) + SKY_E + READ_E**2 + GAIN_E**2 / 12
    return float(1 / np.sqrt((slope**2 / variance).sum()))


def random_positions(rng: np.random.Generator) -> Array:
    """Return random, well-separated positions in a 256 x 512 frame."""
    rows, cols = np.meshgrid(np.arange(24, 240, 42), np.arange(24, 500, 42), indexing="ij")
    return np.column_stack([cols.ravel(), rows.ravel()]) + rng.uniform(-8, 8, (rows.size, 2))


def nearest(detected: Array, truth: Array) -> tuple[Array, Array]:
    """Return the index and the distance of the detected star nearest to each true star."""
    distance_px = np.linalg.norm(truth[:, None] - detected[None], axis=2)
    return distance_px.argmin(1), distance_px.min(1)


def test_position_errors_are_close_to_the_cramer_rao_bound() -> None:
    """Stars over a range of three magnitudes are detected, with at most one false detection. Their errors are at most
    1.05 times the bound and agree with the stated σ.
    """
    rng = np.random.default_rng(11)
    error, bound, sigma, extra = [], [], [], 0
    for _ in range(8):
        xy = random_positions(rng)
        flux = 65_000 * 10 ** (-0.4 * rng.uniform(0, 3, len(xy)))
        detected = find_stars(
            read_out(expected_electrons((256, 512), xy, flux, 1.0), rng), psf_sigma_px=1.0, saturation_dn=255
        )
        index, distance = nearest(detected.centroids.pixels, xy)
        assert distance.max() < 1.0
        extra += len(detected.centroids) - len(set(index.tolist()))
        error.append(detected.centroids.pixels[index] - xy)
        sigma.append(detected.centroids.sigma_px[index])
        bound.append(
            [cramer_rao_px((64, 64), x % 1 + 31, y % 1 + 31, f, 1.0) for (x, y), f in zip(xy, flux, strict=True)]
        )
    errors_px, bounds_px, sigmas_px = np.concatenate(error), np.concatenate(bound), np.concatenate(sigma)
    assert np.sqrt((errors_px**2).mean()) < 1.05 * np.sqrt((bounds_px**2).mean())
    assert 0.8 < np.sqrt(((errors_px / sigmas_px[:, None]) ** 2).mean()) < 1.1
    assert np.abs(errors_px.mean(0)).max() < 3e-3
    assert extra <= 1


@pytest.mark.parametrize("dtype", ["uint8", "uint16", "float32"])
def test_number_types_give_the_same_stars(dtype: str) -> None:
    """Frames with the same values as uint8, uint16 and float32 give the same positions."""
    rng = np.random.default_rng(12)
    xy = random_positions(rng)[:20]
    frame = read_out(expected_electrons((256, 512), xy, np.full(20, 20_000.0), 1.2), rng)
    first = find_stars(frame).centroids
    other = find_stars(frame.astype(dtype)).centroids
    assert len(first) == len(other)
    assert np.allclose(first.pixels, other.pixels, atol=5e-3)


def test_width_is_measured_on_frames_of_unknown_cameras() -> None:
    """The width of the point-spread function is measured from the frame within 0.12 px."""
    rng = np.random.default_rng(13)
    xy = random_positions(rng)[:30]
    for sigma in (0.8, 1.5, 2.5):
        detected = find_stars(read_out(expected_electrons((256, 512), xy, np.full(30, 60_000.0), sigma), rng))
        assert abs(detected.psf_sigma_px - np.hypot(sigma, 0.29)) < 0.12
        _, distance = nearest(detected.centroids.pixels, xy)
        assert np.median(distance) < 0.1


def test_hot_pixels_are_not_detected_as_stars() -> None:
    """With a thousand isolated hot pixels, the stars are detected, most hot pixels are rejected, and a note states
    them.
    """
    rng = np.random.default_rng(14)
    xy = random_positions(rng)[:15]
    frame = read_out(expected_electrons((256, 512), xy, np.full(15, 40_000.0), 1.1), rng)
    hot = rng.permutation(frame.size)[:1000]
    frame.ravel()[hot] = np.maximum(frame.ravel()[hot], rng.integers(60, 256, 1000)).astype(np.uint8)
    detected = find_stars(frame, psf_sigma_px=1.1)
    _, distance = nearest(detected.centroids.pixels, xy)
    assert (distance < 1).sum() >= 13  # a hot pixel in the core can spoil one or two stars
    assert len(detected.centroids) < 60
    assert any(r.rejected for r in detected.regions)
    assert any("hot pixels" in note for note in detected.notes)


def test_a_bright_column_is_not_detected_as_stars() -> None:
    """A defective bright column gives no centroids."""
    rng = np.random.default_rng(15)
    frame = read_out(np.zeros((128, 128)), rng)
    frame[:, 40] = np.clip(frame[:, 40].astype(int) + 60, 0, 255)
    assert len(find_stars(frame, psf_sigma_px=1.0).centroids) == 0


def test_a_saturated_star_gives_one_centroid() -> None:
    """A heavily saturated star gives one centroid within a tenth of a pixel."""
    rng = np.random.default_rng(16)
    xy = np.array([[60.3, 40.7], [100.2, 90.1], [30.4, 100.6]])
    frame = read_out(expected_electrons((128, 128), xy, np.array([600_000.0, 30_000.0, 25_000.0]), 1.2), rng)
    detected = find_stars(frame, psf_sigma_px=1.2, saturation_dn=255).centroids
    assert len(detected) == 3
    assert np.hypot(*(detected.pixels[0] - xy[0])) < 0.1


def test_a_close_pair_gives_two_centroids() -> None:
    """Two stars four sigmas apart give two centroids, each within a tenth of a pixel."""
    rng = np.random.default_rng(17)
    xy = np.array([[60.3, 60.7], [64.6, 61.9]])
    frame = read_out(expected_electrons((128, 128), xy, np.array([60_000.0, 40_000.0]), 1.0), rng)
    detected = find_stars(frame, psf_sigma_px=1.0, saturation_dn=255).centroids
    assert len(detected) == 2
    _, distance = nearest(detected.pixels, xy)
    assert distance.max() < 0.1


def test_centroids_of_trails_are_their_midpoints() -> None:
    """Stars trailed over ten pixels are recognised as trails, with their length and direction. Their positions are the
    midpoints.
    """
    rng = np.random.default_rng(18)
    xy = random_positions(rng)[:24]
    angle = np.radians(25)
    along = np.linspace(-5, 5, 21)[:, None] * [np.cos(angle), np.sin(angle)]
    light = sum(expected_electrons((256, 512), xy + step, np.full(24, 200_000.0 / 21), 1.0) for step in along)
    detected = find_stars(read_out(np.asarray(light), rng))
    assert 7 < detected.streak_px < 13
    assert abs(np.degrees(detected.streak_direction_rad) - 25) < 5
    _, distance = nearest(detected.centroids.pixels, xy)
    assert np.median(distance) < 0.3
    assert (distance < 1.0).sum() >= 22


@pytest.mark.parametrize(("length_px", "is_cut"), [(20, False), (40, True)])
def test_trails_that_are_detected_in_parts_are_recognised(length_px: float, is_cut: bool) -> None:
    """A trail of 20 px is detected as a whole. Of a trail of 40 px only parts are detected, at wrong positions."""
    rng = np.random.default_rng(19)
    xy = random_positions(rng)[:16]
    along = np.linspace(-length_px / 2, length_px / 2, 81)[:, None] * [np.cos(0.4), np.sin(0.4)]
    light = sum(expected_electrons((256, 512), xy + step, np.full(16, 400_000.0 / 81), 1.0) for step in along)
    detected = find_stars(read_out(np.asarray(light), rng))
    assert detected.trailed
    assert detected.cut_trails == is_cut


@pytest.mark.parametrize("value", [0, 7, 255])
def test_constant_frames_have_no_stars(value: int) -> None:
    """Black, grey and white frames give no centroids."""
    assert len(find_stars(np.full((64, 96), value, np.uint8)).centroids) == 0


def test_noise_alone_gives_few_false_detections() -> None:
    """Four megapixels of noise give at most three false detections."""
    rng = np.random.default_rng(19)
    total = sum(
        len(find_stars(rng.normal(40, 6, (1000, 1000)).astype(np.float32), psf_sigma_px=1.0).centroids)
        for _ in range(4)
    )
    assert total <= 3


def test_arrays_that_are_not_frames_are_rejected() -> None:
    """Arrays with three axes, tiny arrays, complex numbers and NaN are rejected."""
    with_nan = np.zeros((20, 20))
    with_nan[3, 4] = np.nan
    for array in (np.zeros((4, 4)), np.zeros((20, 20, 3)), np.zeros((20, 20), complex), with_nan):
        with pytest.raises(BadInput):
            find_stars(array)


def test_second_moments_below_zero_give_the_narrowest_width() -> None:
    """Noise can make second moments negative; both axes then get the minimum width."""
    assert widths_px(np.array([[-0.3, 0.1], [0.1, -0.2]])) == (NARROWEST_PX, NARROWEST_PX)
    low, high = widths_px(np.array([[4.0, 0.0], [0.0, 1.0]]))
    assert (low, high) == (1.0, 2.0)


@pytest.mark.parametrize("shape", [(8, 8), (9, 13), (8, 200), (120, 97)])
@pytest.mark.parametrize("dtype", ["uint8", "float32"])
def test_the_filter_for_elongated_stars_is_a_convolution(shape: tuple[int, int], dtype: str) -> None:
    """The filtered frame is equal to a direct convolution with repeated edge pixels, for any size. A pixel of 1e12 in a frame
    of floating-point numbers changes only its neighbours."""
    image = np.random.default_rng(2).integers(90, 110, shape).astype(dtype)
    if dtype == "float32":
        image[0, 0] = 1e12
    covariance = np.array([[9.0, 2.0], [2.0, 1.0]])
    smooth, _, _ = _filter_frame(image, covariance)
    high = np.sqrt(np.linalg.eigvalsh(covariance)[1])
    half = int(np.ceil(2.5 * high))
    y, x = np.mgrid[-half : half + 1, -half : half + 1]
    kernel = np.exp(-0.5 * np.einsum("kij,kl,lij->ij", np.stack([x, y]), np.linalg.inv(covariance), np.stack([x, y])))
    direct = ndimage.convolve(image.astype(float), kernel / kernel.sum(), mode="nearest")
    assert (smooth.dtype, smooth.flags["C_CONTIGUOUS"]) == (np.float32, True)
    assert np.allclose(smooth, direct, rtol=1e-5, atol=0.05)
