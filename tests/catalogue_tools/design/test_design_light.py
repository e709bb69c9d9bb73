"""Camera designs: radiometry and centroid errors, compared with rendered noisy frames."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gss.catalogue_tools.design import radiometry
from gss.catalogue_tools.design.camera import DesignCamera
from gss.catalogue_tools.design.centroid_bound import bound_px, centroid_sigma_px, exact_bound_px, psf_advice
from gss.domain.errors import BadInput, NotFound
from gss.instruments.registry import shipped_camera, shipped_registry
from gss.pipeline.psf import cut_stamps, fit_stars
from gss.pipeline.render import spots


def test_design_cameras_have_the_zero_point_noise_and_field_of_their_profile() -> None:
    """A design camera created from a profile has the profile's zero point, noise, pixel size and aperture. Sunsat's
    field is that of the document.
    """
    for camera in map(DesignCamera.from_profile, (i.profile for i in shipped_registry().all() if i.profile.chain)):
        profile = shipped_camera(camera.name)
        assert camera.zero_point_e_s == pytest.approx(profile.sensor.zero_point_e_s)
        assert camera.noise_e == pytest.approx(profile.sensor.noise_e(camera.exposure_s))
        assert camera.camera.pixel_rad == pytest.approx(profile.camera.pixel_rad, rel=1e-9)
        assert camera.aperture_cm2 == pytest.approx(profile.aperture_cm2)
        assert 0 < camera.efficiency <= 1
    fov = np.degrees(DesignCamera.from_profile(shipped_camera("sunsat")).fov_rad)
    assert fov == pytest.approx([11.17, 8.32], abs=0.005)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"focal_mm": 0.1}, "focal_mm is out of range"),
        ({"focal_mm": float("nan")}, "focal_mm is out of range"),
        ({"exposure_s": 0.0}, "exposure_s is out of range"),
        ({"columns": 100.5}, "not a whole number"),
        ({"bits": 4, "bias_dn": 20.0}, "bias fills the range"),
        ({"focal_mm": 1.0, "columns": 8000}, "too wide for a flat detector"),
        ({"mag_limit": 20.0}, "limiting magnitude"),
        ({"colour": 1.0}, "unknown camera parameter"),
    ],
)
def test_invalid_cameras_are_rejected(changes: dict[str, float], message: str) -> None:
    """Each invalid number is rejected with the expected range."""
    with pytest.raises(BadInput, match=message) as error:
        DesignCamera.from_profile(shipped_camera("sunsat")).edited(**changes)
    assert error.value.expected


def test_an_unknown_camera_is_rejected() -> None:
    """An unknown camera is rejected with a list of the valid ones."""
    with pytest.raises(NotFound, match="sunsat"):
        shipped_camera("hubble")


def test_brightest_pixel_share_agrees_with_rendered_spots() -> None:
    """Mean, centred and trailed shares of the brightest pixel agree with spots from the renderer."""
    phases = (np.arange(9) + 0.5) / 9 - 0.5
    for sigma in (0.45, 1.2, 2.5):
        peaks = [spots(21, 21, np.array([[10 + x, 10 + y]]), np.ones(1), sigma)[10, 10] for x in phases for y in phases]
        assert radiometry.brightest_pixel_share(sigma) == pytest.approx(np.mean(peaks), rel=1e-6)
        assert radiometry.brightest_pixel_share(sigma, centred=True) == pytest.approx(
            spots(21, 21, np.array([[10.0, 10.0]]), np.ones(1), sigma)[10, 10], rel=1e-6
        )
    steps = 5 * ((np.arange(400) + 0.5) / 400 - 0.5)
    rendered = spots(21, 31, np.stack([15 + steps, np.full(400, 10.0)], axis=-1), np.full(400, 1 / 400), 1.2)[10, 15]
    assert radiometry.brightest_pixel_share(1.2, 5.0, centred=True) == pytest.approx(rendered, rel=1e-4)


def test_snr_at_the_limit_is_the_threshold() -> None:
    """At both limits the SNR is the threshold. A longer exposure, a larger lens and less noise give a fainter limit."""
    for camera in map(DesignCamera.from_profile, (i.profile for i in shipped_registry().all() if i.profile.chain)):
        assert float(
            radiometry.snr_brightest_pixel(camera, radiometry.limit_brightest_pixel_mag(camera))
        ) == pytest.approx(camera.threshold_snr)
        assert float(radiometry.snr_window(camera, radiometry.limit_window_mag(camera))) == pytest.approx(
            camera.threshold_snr
        )
        assert radiometry.limit_window_mag(camera) >= radiometry.limit_brightest_pixel_mag(camera)
        for better in (
            replace(camera, exposure_s=2 * camera.exposure_s),
            replace(camera, f_number=camera.f_number / 1.2),
            replace(camera, read_noise_e=camera.read_noise_e / 2),
        ):
            assert radiometry.limit_mag(better) > radiometry.limit_mag(camera)
        assert radiometry.limit_mag(replace(camera, mag_limit=3.3)) == 3.3


def test_limits_agree_with_the_documents() -> None:
    """The radiometry agrees with Sunsat's limit of V 6 within 0.6 mag, and with its saturation at V 2.5 and FAR-MST's
    limit of V 4.5 within 0.3 mag.
    """
    sunsat, far_mst = (
        DesignCamera.from_profile(shipped_camera("sunsat")),
        DesignCamera.from_profile(shipped_camera("far_mst")),
    )
    assert radiometry.limit_mag(sunsat) == pytest.approx(6.0, abs=0.6)
    assert radiometry.saturation_mag(sunsat) == pytest.approx(2.5, abs=0.3)
    assert radiometry.limit_mag(far_mst) == pytest.approx(4.5, abs=0.3)


def test_motion_at_the_blur_rate_costs_half_a_magnitude() -> None:
    """The trail at the blur rate costs 0.5 mag, and the blur rate causes this trail in one exposure."""
    for camera in map(DesignCamera.from_profile, (i.profile for i in shipped_registry().all() if i.profile.chain)):
        blur = radiometry.motion_blur(camera)
        assert float(radiometry.blur_loss_mag(camera.psf_sigma_px, np.array([blur.streak_px]))[0]) == pytest.approx(
            0.5, abs=1e-6
        )
        assert blur.rate_rad_s * camera.exposure_s / camera.camera.pixel_rad == pytest.approx(blur.streak_px)
        assert blur.smear_limit_rate_rad_s < blur.rate_rad_s


def test_the_reference_fit_reaches_the_cramer_rao_bound() -> None:
    """The scatter of least-squares fits to noisy stamps agrees with the Cramér–Rao bound within 10 %, for bright and
    faint stars.
    """
    rng = np.random.default_rng(4)
    sigma, noise, n = 1.2, 42.0, 600
    side = 21
    covariance = np.eye(2) * (sigma**2 + 1 / 12)
    for electrons in (6_000.0, 200_000.0):
        true_px = 10 + rng.uniform(-0.5, 0.5, (n, 2))
        frame = np.concatenate(
            [spots(side, side, true_px[k : k + 1], np.array([electrons]), sigma) for k in range(n)], axis=1
        )
        frame = rng.poisson(frame) + rng.normal(0, noise, frame.shape)
        col = np.arange(n) * side + 10
        stamps = cut_stamps(frame, col, np.full(n, 10), np.zeros(n), 6, np.inf)
        fit = fit_stars(stamps, col + 0.0, np.full(n, 10.0), covariance, np.full(n, noise), 1.0)
        assert fit.good.mean() > 0.99
        error = np.stack([fit.col - np.arange(n) * side - true_px[:, 0], fit.row - true_px[:, 1]])[:, fit.good]
        bound = float(bound_px(electrons, sigma, noise))
        assert np.std(error) == pytest.approx(bound, rel=0.1)


def test_interpolated_bound_agrees_with_the_exact_bound() -> None:
    """The interpolated bound is within 0.2 % of the exact one. Uneven response sets a lower limit."""
    electrons = np.geomspace(30, 1e7, 37)
    assert bound_px(electrons, 1.2, 42.0, 0.01) == pytest.approx(exact_bound_px(electrons, 1.2, 42.0, 0.01), rel=2e-3)
    assert bound_px(1e8, 1.2, 42.0, 0.01) > 5 * bound_px(1e8, 1.2, 42.0, 0.0)


def test_best_star_width_agrees_with_moniteq() -> None:
    """Noise and pixel bias together are smallest if a pixel is 2 to 3 σ (Moniteq §4.2: 2 to 2.5). Narrower star images
    are rated sharp.
    """
    camera = DesignCamera.from_profile(shipped_camera("sunsat"))
    advice = psf_advice(camera)
    assert 2.0 <= 1 / advice.best_px <= 3.0
    assert psf_advice(replace(camera, psf_sigma_px=0.3)).kind == "sharp"
    assert psf_advice(replace(camera, psf_sigma_px=0.5)).kind == "good"
    assert advice.kind == "wide"
    assert float(centroid_sigma_px(camera, 3.0)) < float(centroid_sigma_px(camera, 6.0))


def test_dark_current_may_fill_the_converter() -> None:
    """1008 counts per second fill the 4096 levels of the converter in 4.06 s (Erlank §3.4.4). In longer exposures every
    star saturates.
    """
    camera = replace(
        DesignCamera.from_profile(shipped_camera("cubestar")),
        bits=12,
        gain_e_per_dn=1.0,
        bias_dn=0.0,
        dark_current_e_s=1008.0,
        background_e_s=0.0,
    )
    assert radiometry.longest_exposure_s(camera) == pytest.approx(4.06, abs=0.01)
    assert radiometry.saturation_mag(replace(camera, exposure_s=5.0)) == float("inf")
    assert isinstance(camera, DesignCamera)
