"""The renderer, compared with a FITS WCS, numerical integration and sensor statistics."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from astropy.wcs import WCS, Sip
from scipy.integrate import dblquad

from gss.catalogue_tools.sources.hipparcos import load_stars
from gss.domain.angles import Array, ra_dec_from_unit, unit_from_ra_dec
from gss.domain.camera import Brown, Camera
from gss.domain.errors import BadInput
from gss.domain.frames import cam_from_icrs
from gss.domain.rotation import matrix_from_quaternion, random_quaternion, rotation_from_vector
from gss.domain.sensor import Defects
from gss.domain.stars import StarTable
from gss.instruments.registry import shipped_camera
from gss.pipeline.render import FalseStar, FixedPattern, HotPixel, expose, render, spots

CUBESTAR = shipped_camera("cubestar")
CAMERA, SENSOR = CUBESTAR.camera, CUBESTAR.sensor
NOISELESS = replace(SENSOR, bits=16, gain_e_per_dn=0.05, full_well_e=1e9, background_e_s=0.0, dark_current_e_s=0.0)


@lru_cache
def _sky() -> StarTable:
    return load_stars(6.5)


def _one_star(v_mag: float = 2.0) -> StarTable:
    return replace(_sky().take(np.array([0])), icrs=np.array([[0, 0, 1.0]]), v_mag=np.array([v_mag]))


def _attitude(seed: int) -> Array:
    return matrix_from_quaternion(random_quaternion(np.random.default_rng(seed)))


def _wcs(camera: Camera, ra_rad: float, dec_rad: float, roll_rad: float) -> WCS:
    """Return the TAN header of a pinhole camera: 1-based reference pixel, north at ``roll`` counter-clockwise from
    −row.
    """
    wcs = WCS(naxis=2)
    wcs.wcs.ctype = ["RA---TAN", "DEC--TAN"]
    wcs.wcs.crval = np.degrees([ra_rad, dec_rad])
    wcs.wcs.crpix = [camera.centre_col_px + 1, camera.centre_row_px + 1]
    c, s = np.cos(roll_rad), np.sin(roll_rad)
    scale = np.degrees(1 / np.array([camera.focal_col_px, camera.focal_row_px]))
    wcs.wcs.cd = np.array([[-c, s], [-s, -c]]) * scale
    return wcs


@pytest.mark.parametrize(
    ("ra_deg", "dec_deg", "roll_deg"), [(10, 20, 0), (200, -70, 123), (359.9, 89, 300), (77, 0, 45)]
)
def test_projection_agrees_with_a_fits_header(ra_deg: float, dec_deg: float, roll_deg: float) -> None:
    """A pinhole camera with unequal focal lengths projects every star onto the position of astropy's TAN WCS within
    1e-9 px.
    """
    camera = replace(CAMERA, focal_row_px=1300.0, centre_col_px=500.25, distortion=Brown())
    ra, dec, roll = np.radians([ra_deg, dec_deg, roll_deg])
    rotation = cam_from_icrs(ra, dec, roll)
    truth = render(_sky(), camera, SENSOR, rotation, 0.1, np.random.default_rng(0), noise=False).truth
    icrs_of = {int(h): v for h, v in zip(_sky().hip, _sky().icrs, strict=True)}
    icrs = np.array([icrs_of[int(h)] for h in truth.hip])
    world = np.degrees(np.column_stack(ra_dec_from_unit(icrs)))
    assert len(truth.hip) > 50
    np.testing.assert_allclose(_wcs(camera, ra, dec, roll).wcs_world2pix(world, 0), truth.pixels, atol=1e-9)


def test_distortion_agrees_with_a_sip_polynomial() -> None:
    """Brown's coefficients, converted to the inverse SIP polynomial, move pixels exactly as the camera does."""
    lens = CAMERA.distortion
    assert isinstance(lens, Brown)
    focal_px = CAMERA.focal_col_px
    a, b = np.zeros((6, 6)), np.zeros((6, 6))
    for (i, j), k in {(3, 0): lens.k1, (1, 2): lens.k1, (5, 0): lens.k2, (3, 2): 2 * lens.k2, (1, 4): lens.k2}.items():
        a[i, j], b[j, i] = k / focal_px ** (i + j - 1), k / focal_px ** (i + j - 1)
    a[1, 1], a[2, 0], a[0, 2] = 2 * lens.p1 / focal_px, 3 * lens.p2 / focal_px, lens.p2 / focal_px
    b[1, 1], b[2, 0], b[0, 2] = 2 * lens.p2 / focal_px, lens.p1 / focal_px, 3 * lens.p1 / focal_px
    wcs = _wcs(CAMERA, 1.0, 0.3, 2.0)
    wcs.sip = Sip(np.zeros((6, 6)), np.zeros((6, 6)), a, b, wcs.wcs.crpix)
    rng = np.random.default_rng(1)
    cam = np.column_stack([rng.uniform(-0.45, 0.45, 500), rng.uniform(-0.22, 0.22, 500), np.ones(500)])
    cam /= np.linalg.norm(cam, axis=1, keepdims=True)
    world = np.degrees(np.column_stack(ra_dec_from_unit(cam @ cam_from_icrs(1.0, 0.3, 2.0))))
    undistorted = wcs.wcs_world2pix(world, 1)
    distorted = wcs.sip_foc2pix(undistorted - wcs.wcs.crpix, 1)
    np.testing.assert_allclose(distorted - 1, CAMERA.project(cam), atol=1e-9)


def test_light_of_a_pixel_is_the_integral_of_the_gaussian() -> None:
    """The light in a pixel is the double integral of the spot over it, and the sum is the light of the star."""
    image = spots(31, 41, np.array([[20.3, 15.6]]), np.array([1000.0]), 1.2)

    def density(y: float, x: float) -> float:
        return 1000 * np.exp(-((x - 20.3) ** 2 + (y - 15.6) ** 2) / (2 * 1.44)) / (2 * np.pi * 1.44)

    for col, row in ((20, 16), (18, 15), (23, 13)):
        expected, _ = dblquad(density, col - 0.5, col + 0.5, row - 0.5, row + 0.5)
        assert image[row, col] == pytest.approx(expected, rel=1e-6)
    assert image.sum() == pytest.approx(1000, rel=1e-5)


def test_spots_across_the_edge_are_clipped() -> None:
    """A star on the edge gives half its light and one in the corner a quarter. NaN and distant positions give none."""
    positions = np.array([[-0.5, 10.0], [-0.5, -0.5], [np.nan, 5], [1e9, 5], [-30, 5]])
    image = spots(20, 30, positions, np.full(5, 100.0), 1.0)
    assert image.sum() == pytest.approx(75, rel=1e-5)
    assert image[:, 15:].sum() < 1e-9


def test_a_bright_star_is_at_its_true_position() -> None:
    """The centre of gravity of a noiseless star is its true position within 0.002 px, and its light is that of the
    sensor model.
    """
    attitude = rotation_from_vector(np.array([0.05, -0.12, 0.3]))
    frame = render(_one_star(3), CAMERA, NOISELESS, attitude, 0.25, np.random.default_rng(0), noise=False)
    light = frame.pixels.astype(float) - NOISELESS.bias_dn
    row, col = np.indices(light.shape)
    centre = [(light * col).sum() / light.sum(), (light * row).sum() / light.sum()]
    np.testing.assert_allclose(centre, frame.truth.pixels[0], atol=2e-3)
    assert light.sum() * NOISELESS.gain_e_per_dn == pytest.approx(float(SENSOR.star_e(3, 0.25)), rel=1e-3)


def test_a_dark_sky_has_the_noise_of_the_sensor() -> None:
    """An empty frame has the mean and the standard deviation of the sensor model."""
    sensor = replace(SENSOR, bits=12)
    frame = expose(np.zeros((400, 500)), sensor, 0.25, np.random.default_rng(3)).astype(float)
    mean_dn = sensor.bias_dn + (sensor.dark_current_e_s + sensor.background_e_s) * 0.25 / sensor.gain_e_per_dn
    assert frame.mean() == pytest.approx(mean_dn, abs=0.01)
    assert frame.std() == pytest.approx(sensor.noise_e(0.25) / sensor.gain_e_per_dn, rel=0.01)


def test_starlight_has_shot_noise() -> None:
    """Uniform light of 2000 e⁻ has shot noise of √2000 e⁻ in addition to the dark noise."""
    sensor = replace(SENSOR, bits=12)
    frame = expose(np.full((300, 300), 2000.0), sensor, 0.25, np.random.default_rng(4)) * sensor.gain_e_per_dn
    assert frame.std() == pytest.approx(np.hypot(np.sqrt(2000), sensor.noise_e(0.25)), rel=0.01)


def test_values_are_clipped_at_the_converter_and_the_full_well() -> None:
    """Eight-bit values are clipped at 255 and twelve-bit values at the full well. The data type follows the number of
    bits.
    """
    light = np.full((4, 4), 1e7)
    assert expose(light, SENSOR, 0.25, np.random.default_rng(0)).dtype == np.uint8
    assert (expose(light, SENSOR, 0.25, np.random.default_rng(0)) == 255).all()
    deep = replace(SENSOR, bits=12)
    full = expose(light, deep, 0.25, np.random.default_rng(0), noise=False)
    assert full.dtype == np.uint16
    assert (full == SENSOR.bias_dn + SENSOR.full_well_e / SENSOR.gain_e_per_dn).all()


def test_the_seed_determines_the_frame() -> None:
    """The same seed gives the same pixels, and another seed gives others. A fixed pattern is the same in every frame."""

    def frame(seed: int, pattern: FixedPattern | None = None) -> Array:
        rng = np.random.default_rng(seed)
        return render(_sky(), CAMERA, SENSOR, _attitude(5), 0.25, rng, fixed_pattern=pattern).pixels.astype(float)

    np.testing.assert_array_equal(frame(1), frame(1))
    assert (frame(1) != frame(2)).mean() > 0.3
    chip = FixedPattern(9, offset_sigma_dn=3.0)
    first, second = frame(1, chip) - frame(1), frame(2, chip) - frame(2)
    assert np.corrcoef(first.ravel(), second.ravel())[0, 1] > 0.9


def test_hot_pixels_and_false_stars_have_the_requested_positions() -> None:
    """A hot pixel affects one pixel and a false star is a spot. Neither is in the truth."""
    plain = render(_sky(), CAMERA, SENSOR, _attitude(6), 0.25, np.random.default_rng(1), noise=False)
    with_defects = render(
        _sky(),
        CAMERA,
        SENSOR,
        _attitude(6),
        0.25,
        np.random.default_rng(1),
        noise=False,
        hot_pixels=[HotPixel(30, 40, 2000.0)],
        false_stars=[FalseStar(700.2, 300.7, 2.5)],
    )
    difference = with_defects.pixels.astype(int) - plain.pixels
    assert difference[40, 30] == 100
    assert np.count_nonzero(difference[30:51, 20:41]) == 1
    difference[40, 30] = 0
    assert np.unravel_index(np.argmax(difference), difference.shape) == (301, 700)
    np.testing.assert_array_equal(with_defects.truth.hip, plain.truth.hip)


def test_a_trail_connects_the_positions_at_start_and_end() -> None:
    """With a rotating camera, the star is a line between its positions at the start and at the end of the exposure,
    with the same light.
    """
    rate, exposure_s = np.array([0.0, 0.03, 0.05]), 1.0
    middle = rotation_from_vector(np.array([0.1, 0.1, 0.0]))
    still = render(_one_star(4), CAMERA, NOISELESS, middle, exposure_s, np.random.default_rng(0), noise=False)
    trailed = render(
        _one_star(4), CAMERA, NOISELESS, middle, exposure_s, np.random.default_rng(0), noise=False, rate_rad_s=rate
    )
    ends = [CAMERA.project(_one_star().icrs @ (rotation_from_vector(-rate * t) @ middle).T)[0] for t in (-0.5, 0.5)]
    length_px = float(np.linalg.norm(ends[1] - ends[0]))
    light = trailed.pixels.astype(float) - NOISELESS.bias_dn
    assert 20 < length_px < 60
    assert light.sum() == pytest.approx((still.pixels - NOISELESS.bias_dn).sum(), rel=0.05)
    row, col = np.nonzero(light > light.max() * 0.2)
    extent = np.array([[col.min(), col.max()], [row.min(), row.max()]])
    expected = np.sort(np.array(ends).T, axis=1)
    np.testing.assert_allclose(extent, expected, atol=2.5)


def test_truth_lists_the_visible_stars() -> None:
    """The truth lists exactly the stars on the detector and in front of the camera, brightest first."""
    rotation = _attitude(8)
    truth = render(_sky(), CAMERA, SENSOR, rotation, 0.1, np.random.default_rng(0), noise=False).truth
    cam = _sky().icrs @ rotation.T
    angle_ok = cam[:, 2] > np.cos(CAMERA.half_diagonal_rad + 0.01)
    inside = CAMERA.contains(CAMERA.project(cam)) & angle_ok
    assert set(truth.hip.tolist()) == set(_sky().hip[inside].tolist())
    assert (np.diff(truth.v_mag) >= 0).all()
    np.testing.assert_allclose(matrix_from_quaternion(truth.quaternion), rotation, atol=1e-14)


def test_invalid_exposures_are_rejected() -> None:
    """An exposure time of zero, a trail that is too long and a hot pixel outside the detector are rejected."""
    rng = np.random.default_rng(0)
    with pytest.raises(BadInput, match="exposure"):
        render(_sky(), CAMERA, SENSOR, np.eye(3), 0.0, rng)
    with pytest.raises(BadInput, match="too fast"):
        render(_sky(), CAMERA, SENSOR, np.eye(3), 1.0, rng, rate_rad_s=(0, 5.0, 0))
    with pytest.raises(BadInput, match="hot pixel"):
        render(_sky(), CAMERA, SENSOR, np.eye(3), 0.1, rng, hot_pixels=[HotPixel(2000, 3, 1.0)])


def test_a_sky_without_stars_gives_a_dark_frame() -> None:
    """Without stars the frame is rendered and the truth is empty."""
    no_stars = _sky().take(np.zeros(0, np.intp))
    frame = render(no_stars, CAMERA, SENSOR, np.eye(3), 0.1, np.random.default_rng(0))
    assert frame.pixels.shape == (512, 1024)
    assert len(frame.truth.hip) == 0


def test_world_coordinates_convert_back_to_unit_vectors() -> None:
    """The world coordinates that the WCS tests use convert back to the catalogue's vectors."""
    ra, dec = ra_dec_from_unit(_sky().icrs)
    np.testing.assert_allclose(unit_from_ra_dec(ra, dec), _sky().icrs, atol=1e-14)


def _width_px(light: Array) -> float:
    """Return the standard deviation of the columns of a spot."""
    column = np.arange(light.shape[1])
    share = light.sum(axis=0) / light.sum()
    middle = float(share @ column)
    return float(np.sqrt(share @ (column - middle) ** 2))


def test_a_curved_field_widens_stars_towards_the_corner() -> None:
    """The additional width is zero on the axis and a quarter of the corner's at half the distance. The light of the star is
    unchanged (Huffman 2006 Fig. 2.4)."""
    camera = shipped_camera("far_mst").camera
    half_way = np.array([[camera.centre_col_px, camera.centre_row_px], [camera.columns / 4, camera.rows / 4]])
    stars = replace(_sky().take(np.arange(2)), icrs=camera.unproject(half_way), v_mag=np.array([4.0, 4.0]))
    drawn = (
        render(
            stars,
            camera,
            NOISELESS,
            np.eye(3),
            1.0,
            np.random.default_rng(1),
            noise=False,
            defects=Defects(corner_blur_px=8.0),
        ).pixels.astype(float)
        - NOISELESS.bias_dn
    )
    pixel2 = NOISELESS.psf_sigma_px**2 + 1 / 12
    for (col, row), blur_px in zip(np.rint(half_way).astype(int), (0.0, 2.0), strict=True):
        stamp = drawn[row - 40 : row + 41, col - 40 : col + 41]
        assert _width_px(stamp) == pytest.approx(np.sqrt(pixel2 + blur_px**2), rel=0.03)
        assert stamp.sum() * NOISELESS.gain_e_per_dn == pytest.approx(float(NOISELESS.star_e(4.0, 1.0)), rel=0.01)


def test_a_rolling_shutter_shears_a_turning_field() -> None:
    """Each star is where the attitude at the time of its row puts it; the middle row has the attitude of the frame. A camera
    at rest is not affected."""
    rate, skew_s = np.array([0.0, 0.05, 0.0]), 0.4
    attitude, rng = _attitude(5), np.random.default_rng(1)
    defects = Defects(row_skew_ms=1000 * skew_s)
    still = render(_sky(), CAMERA, SENSOR, attitude, 0.01, rng, noise=False, rate_rad_s=rate).truth
    rolled = render(_sky(), CAMERA, SENSOR, attitude, 0.01, rng, noise=False, rate_rad_s=rate, defects=defects).truth
    common, a, b = np.intersect1d(still.hip, rolled.hip, return_indices=True)
    assert len(common) > 30
    moved = np.linalg.norm(rolled.pixels[b] - still.pixels[a], axis=1)
    assert moved.max() > 8
    rows = {int(h): i for i, h in enumerate(_sky().hip)}
    for hip, pixel in zip(rolled.hip, rolled.pixels, strict=True):
        late_s = (np.clip(pixel[1] / (CAMERA.rows - 1), 0, 1) - 0.5) * skew_s
        at_row = rotation_from_vector(-rate * late_s) @ attitude
        assert CAMERA.project(_sky().icrs[rows[int(hip)]][None] @ at_row.T)[0] == pytest.approx(pixel, abs=0.01)
    rest = render(_sky(), CAMERA, SENSOR, attitude, 0.01, rng, noise=False, defects=defects).truth
    assert np.array_equal(rest.pixels, still.pixels)
