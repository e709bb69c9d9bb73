"""FAR-MST's stages between pixels and centroids, compared with literal implementations and with the document's figures."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import ndimage

from gss.domain.errors import BadInput
from gss.instruments.registry import shipped_camera
from gss.pipeline.chains.far_mst_centroid import document_sigma_px
from gss.pipeline.chains.far_mst_detect import clusters, find_centroids, prefiltered
from gss.pipeline.chains.far_mst_parameters import default_parameters, min_prefilter_count
from gss.pipeline.render import spots

PROFILE = shipped_camera("far_mst")
PARAMETERS = default_parameters(PROFILE)
PIXELS = 1280 * 1024


def _mask(seed: int, share: float, shape: tuple[int, int] = (61, 83)) -> np.ndarray:
    return np.random.default_rng(seed).random(shape) < share


@pytest.mark.parametrize("count", [7, 9, 13])
def test_the_sliding_filter_counts_the_25_pixels(count: int) -> None:
    """A lit pixel is kept if at least ``count`` of the 5 x 5 pixels around it are lit; pixels outside the frame are
    dark. The result equals scipy's convolution.
    """
    lit = _mask(1, 0.4)
    lit_neighbours = ndimage.convolve(lit.astype(int), np.ones((5, 5), int), mode="constant")
    np.testing.assert_array_equal(prefiltered(lit, "sliding", count), lit & (lit_neighbours >= count))


def test_the_block_filter_counts_each_block_once() -> None:
    """Blocks of a fixed grid are kept or removed as a whole. Blocks clipped by the edge have fewer pixels to count."""
    lit = _mask(2, 0.45)
    expected = np.zeros_like(lit)
    for r in range(0, 61, 5):
        for c in range(0, 83, 5):
            block = lit[r : r + 5, c : c + 5]
            expected[r : r + 5, c : c + 5] = block & (block.sum() >= 11)
    np.testing.assert_array_equal(prefiltered(lit, "block", 11), expected)
    assert prefiltered(lit, "none", 11) is lit


def test_clusters_are_the_eight_connected_components() -> None:
    """Clusters are those of scipy with eight neighbours, in raster order. The end of a row is not adjacent to the start
    of the next.
    """
    for share in (0.05, 0.2, 0.5):
        lit = _mask(3, share)
        label, count = ndimage.label(lit, np.ones((3, 3), int))
        blobs = clusters(lit)
        assert len(blobs) == count
        for k in range(count):
            pixels = blobs.index[blobs.start[k] : blobs.start[k + 1]]
            assert len(set(label.ravel()[pixels].tolist())) == 1
        first_pixels = blobs.index[blobs.start[:-1]]
        assert np.all(np.diff(first_pixels) > 0)
    assert len(clusters(np.zeros((5, 5), bool))) == 0


def test_noise_passes_the_filter_at_the_binomial_rate() -> None:
    """Of the 208 000 pixels of pure noise above 1 σ, about 5 645 pass with nine of 25, and fewer than 80 with thirteen
    (binomial rates of dossier §3.3).
    """
    noise = np.random.default_rng(4).normal(size=(1024, 1280)) > 1.0
    assert np.count_nonzero(noise) == pytest.approx(207_953, rel=0.01)
    assert np.count_nonzero(prefiltered(noise, "sliding", 9)) == pytest.approx(5645, rel=0.1)
    assert np.count_nonzero(prefiltered(noise, "sliding", 13)) < 80


@pytest.mark.parametrize(("sigma", "count"), [(1.0, 15), (1.5, 11), (2.0, 7), (3.0, 3)])
def test_the_smallest_count_passes_less_than_one_noise_pixel(sigma: float, count: int) -> None:
    """The count is the smallest for which less than one pixel of pure noise is expected to pass. A simulated frame
    agrees.
    """
    assert min_prefilter_count(sigma, PIXELS) == count
    noise = np.random.default_rng(5).normal(size=(1024, 1280)) > sigma
    assert np.count_nonzero(prefiltered(noise, "sliding", count)) <= 6


def test_a_dark_frame_removes_a_pattern() -> None:
    """A gradient that hides the stars is removed by a dark frame. A dark frame of another size is rejected."""
    rng = np.random.default_rng(7)
    true_px = np.array([[50.3, 60.7], [150.2, 90.1], [100.0, 30.0]])
    light = spots(128, 200, true_px, np.full(3, 4000.0), 1.25) / 10
    slope = np.linspace(0, 200, 200)[None] + np.zeros((128, 1))
    frame = np.rint(light + slope + 20 + rng.normal(0, 4, slope.shape)).astype(np.uint16)
    centroids = find_centroids(frame, replace(PARAMETERS, dark_dn=slope + 20)).centroids
    assert len(centroids) == 3
    order = np.argsort(centroids.col_px)
    np.testing.assert_allclose(centroids.pixels[order], true_px[np.argsort(true_px[:, 0])], atol=0.4)
    with pytest.raises(BadInput, match="dark frame"):
        find_centroids(frame, replace(PARAMETERS, dark_dn=np.zeros((3, 3))))


def _scene(seed: int, electrons: float, count: int = 60, sigma_px: float = 1.25) -> tuple[np.ndarray, np.ndarray]:
    """Return a frame of equal stars at random positions near a grid, with the camera's noise, and their true positions."""
    rng = np.random.default_rng(seed)
    col, row = np.meshgrid(np.arange(20, 390, 41), np.arange(20, 290, 43))
    true_px = (np.column_stack([col.ravel(), row.ravel()]) + rng.uniform(-0.5, 0.5, (col.size, 2)))[:count]
    light = spots(300, 400, true_px, np.full(len(true_px), electrons), sigma_px)
    signal = rng.poisson(light) + rng.normal(0, 39.7, light.shape)
    return np.rint(np.clip(signal / 10 + 20, 0, 1023)).astype(np.uint16), true_px


def _errors(frame: np.ndarray, true_px: np.ndarray, **changes: object) -> tuple[np.ndarray, np.ndarray]:
    """Return the (m, 2) errors and the (m,) stated σ of the detected stars."""
    centroids = find_centroids(frame, replace(PARAMETERS, max_centroids=100, **changes)).centroids  # type: ignore[arg-type]
    distance_px = np.linalg.norm(centroids.pixels[:, None] - true_px[None], axis=2)
    nearest = distance_px.argmin(axis=1)
    is_matched = distance_px.min(axis=1) < 2
    return (centroids.pixels - true_px[nearest])[is_matched], centroids.sigma_px[is_matched]


@pytest.mark.parametrize("changes", [{}, {"centroider": "mle"}, {"prefilter": "block"}])
@pytest.mark.parametrize("electrons", [3000.0, 8000.0, 30000.0])
def test_stated_sigma_agrees_with_the_errors(changes: dict[str, object], electrons: float) -> None:
    """Errors divided by their stated σ have an rms between 0.6 and 1.35, for faint, medium and bright stars."""
    normalised = []
    for seed in range(6):
        error, sigma = _errors(*_scene(seed, electrons), **changes)
        assert len(error) >= 25
        normalised.append(error / sigma[:, None])
    assert 0.6 < np.sqrt(np.mean(np.concatenate(normalised) ** 2)) < 1.35


def test_maximum_likelihood_is_more_accurate_than_the_weighted_sum() -> None:
    """Huffman 2006 §4.2.2 found MLE more accurate by about 0.1 px. For faint stars of σ 1.25 px its rms error is at
    least a fifth smaller.
    """
    weighted_sum = np.concatenate([_errors(*_scene(k, 3500.0))[0] for k in range(6)])
    mle = np.concatenate([_errors(*_scene(k, 3500.0), centroider="mle")[0] for k in range(6)])
    assert np.sqrt(np.mean(mle**2)) < 0.8 * np.sqrt(np.mean(weighted_sum**2))


def test_maximum_likelihood_ignores_saturated_pixels() -> None:
    """A star with a clipped core is measured within 0.1 px."""
    frame, true_px = _scene(9, 250_000.0, 20)
    assert frame.max() == 1023
    error, _ = _errors(frame, true_px, centroider="mle")
    assert len(error) >= 18
    assert np.abs(error).max() < 0.1


def test_lines_of_pixels_are_rejected() -> None:
    """A cosmic-ray track among round stars is rejected because of its aspect ratio, and the reason states it."""
    frame, true_px = _scene(10, 20_000.0, 20)
    frame[150:152, 300:340] = 700
    detected = find_centroids(frame, PARAMETERS)
    assert any("aspect ratio" in region.rejected for region in detected.regions)
    assert len(detected.centroids) == len(true_px)


def test_a_bright_sky_gives_no_stars() -> None:
    """If two fifths of the pixels exceed a commanded threshold, no stars are returned, and a note states why."""
    rng = np.random.default_rng(11)
    frame = np.where(rng.random((200, 200)) < 0.4, 800, 20).astype(np.uint16)
    detected = find_centroids(frame, replace(PARAMETERS, threshold_dn=50.0))
    assert len(detected.centroids) == 0
    assert "the sky is not dark" in detected.notes[0]


def test_sigma_of_the_document_is_reproduced() -> None:
    """Eq. 4.2 gives the values of dossier §4.2 at SNR 1, 3, 10 and 100."""
    np.testing.assert_allclose(document_sigma_px(np.array([1.0, 3, 10, 100])), [0.610, 0.230, 0.135, 0.111], atol=6e-4)


def test_invalid_frames_are_rejected() -> None:
    """Arrays that are too small, not two-dimensional or contain NaN are rejected."""
    for shape in ((3, 3), (4, 200), (5, 5, 3)):
        with pytest.raises(BadInput, match="frame"):
            find_centroids(np.zeros(shape, np.uint16), PARAMETERS)
    with pytest.raises(BadInput, match="invalid pixel values"):
        find_centroids(np.full((20, 20), np.nan), PARAMETERS)
