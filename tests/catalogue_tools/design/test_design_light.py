"""Camera designs: the radiometry compared with rendered and noisy frames."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gss.catalogue_tools.design import radiometry as r
from gss.catalogue_tools.design.camera import DesignCamera
from gss.catalogue_tools.design.centroid_bound import bound_px, centroid_sigma_px, exact_bound_px, psf_advice
from gss.domain.errors import BadInput, NotFound
from gss.instruments.registry import shipped_camera, shipped_registry
from gss.pipeline.psf import cut_stamps, fit_stars
from gss.pipeline.render import spots


def test_documents_cameras_keep_their_zero_point_noise_and_field() -> None:
    """A design camera created from a profile has the profile's zero point, noise, pixel size and aperture."""
    for c in map(DesignCamera.from_profile, (i.profile for i in shipped_registry().all() if i.profile.chain)):
        p = shipped_camera(c.name)
        assert c.zero_point_e_s == pytest.approx(p.sensor.zero_point_e_s)
        assert c.noise_e == pytest.approx(p.sensor.noise_e(c.exposure_s))
        assert c.camera.pixel_rad == pytest.approx(p.camera.pixel_rad, rel=1e-9)
        assert c.aperture_cm2 == pytest.approx(p.aperture_cm2)
        assert 0 < c.efficiency <= 1
    fov = np.degrees(DesignCamera.from_profile(shipped_camera("sunsat")).fov_rad)
    assert fov == pytest.approx([11.17, 8.32], abs=0.005)


@pytest.mark.parametrize(
    ("changes", "said"),
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
def test_impossible_cameras_are_rejected(changes: dict[str, float], said: str) -> None:
    """Each impossible number is rejected with the expected range."""
    with pytest.raises(BadInput, match=said) as error:
        DesignCamera.from_profile(shipped_camera("sunsat")).edited(**changes)
    assert error.value.expected


def test_an_unknown_camera_is_rejected() -> None:
    """The error for an unknown camera lists the known ones."""
    with pytest.raises(NotFound, match="sunsat"):
        shipped_camera("hubble")


def test_brightest_pixel_share_is_that_of_drawn_spots() -> None:
    """Mean, centred and streaked shares of the brightest pixel agree with spots drawn by the renderer."""
    phases = (np.arange(9) + 0.5) / 9 - 0.5
    for sigma in (0.45, 1.2, 2.5):
        peaks = [spots(21, 21, np.array([[10 + x, 10 + y]]), np.ones(1), sigma)[10, 10] for x in phases for y in phases]
        assert r.brightest_pixel_share(sigma) == pytest.approx(np.mean(peaks), rel=1e-6)
        assert r.brightest_pixel_share(sigma, centred=True) == pytest.approx(
            spots(21, 21, np.array([[10.0, 10.0]]), np.ones(1), sigma)[10, 10], rel=1e-6
        )
    steps = 5 * ((np.arange(400) + 0.5) / 400 - 0.5)
    drawn = spots(21, 31, np.stack([15 + steps, np.full(400, 10.0)], axis=-1), np.full(400, 1 / 400), 1.2)[10, 15]
    assert r.brightest_pixel_share(1.2, 5.0, centred=True) == pytest.approx(drawn, rel=1e-4)


def test_limits_reach_the_threshold_and_fainter_ones_do_not() -> None:
    """At both limits the SNR is the threshold. A longer exposure, a larger lens and less noise give a fainter limit."""
    for c in map(DesignCamera.from_profile, (i.profile for i in shipped_registry().all() if i.profile.chain)):
        assert float(r.snr_brightest_pixel(c, r.limit_brightest_pixel_mag(c))) == pytest.approx(c.threshold_snr)
        assert float(r.snr_window(c, r.limit_window_mag(c))) == pytest.approx(c.threshold_snr)
        assert r.limit_window_mag(c) >= r.limit_brightest_pixel_mag(c)
        for better in (
            replace(c, exposure_s=2 * c.exposure_s),
            replace(c, f_number=c.f_number / 1.2),
            replace(c, read_noise_e=c.read_noise_e / 2),
        ):
            assert r.limit_mag(better) > r.limit_mag(c)
        assert r.limit_mag(replace(c, mag_limit=3.3)) == 3.3


def test_documents_limits_are_near_ours_where_the_profile_was_made_for_them() -> None:
    """Our radiometry agrees with Sunsat's limit of V 6 within 0.6 mag, and with its saturation at 2.5 and FAR-MST's
    limit of 4.5 within 0.3 mag.
    """
    sunsat, far = (
        DesignCamera.from_profile(shipped_camera("sunsat")),
        DesignCamera.from_profile(shipped_camera("far_mst")),
    )
    assert r.limit_mag(sunsat) == pytest.approx(6.0, abs=0.6)
    assert r.saturation_mag(sunsat) == pytest.approx(2.5, abs=0.3)
    assert r.limit_mag(far) == pytest.approx(4.5, abs=0.3)


def test_half_a_magnitude_is_lost_at_the_rate_that_blurs() -> None:
    """The streak at the blur rate costs 0.5 mag, and that rate causes this streak in one exposure."""
    for c in map(DesignCamera.from_profile, (i.profile for i in shipped_registry().all() if i.profile.chain)):
        blur = r.motion_blur(c)
        assert float(r.blur_loss_mag(c.psf_sigma_px, np.array([blur.streak_px]))[0]) == pytest.approx(0.5, abs=1e-6)
        assert blur.rate_rad_s * c.exposure_s / c.camera.pixel_rad == pytest.approx(blur.streak_px)
        assert blur.smear_limit_rate_rad_s < blur.rate_rad_s


def test_bound_is_met_by_the_reference_chains_fit() -> None:
    """The scatter of least-squares fits to noisy stamps agrees with the Cramér–Rao bound within a tenth, for bright and
    faint stars.
    """
    rng = np.random.default_rng(4)
    sigma, noise, n = 1.2, 42.0, 600
    side = 21
    covariance = np.eye(2) * (sigma**2 + 1 / 12)
    for electrons in (6_000.0, 200_000.0):
        place = 10 + rng.uniform(-0.5, 0.5, (n, 2))
        frame = np.concatenate(
            [spots(side, side, place[k : k + 1], np.array([electrons]), sigma) for k in range(n)], axis=1
        )
        frame = rng.poisson(frame) + rng.normal(0, noise, frame.shape)
        col = np.arange(n) * side + 10
        stamps = cut_stamps(frame, col, np.full(n, 10), np.zeros(n), 6, np.inf)
        fit = fit_stars(stamps, col + 0.0, np.full(n, 10.0), covariance, np.full(n, noise), 1.0)
        assert fit.good.mean() > 0.99
        error = np.stack([fit.col - np.arange(n) * side - place[:, 0], fit.row - place[:, 1]])[:, fit.good]
        bound = float(bound_px(electrons, sigma, noise))
        assert np.std(error) == pytest.approx(bound, rel=0.1)


def test_bound_table_is_the_exact_bound() -> None:
    """The interpolated bound is within 0.2 % of the exact one. Uneven response sets a lower limit."""
    e = np.geomspace(30, 1e7, 37)
    assert bound_px(e, 1.2, 42.0, 0.01) == pytest.approx(exact_bound_px(e, 1.2, 42.0, 0.01), rel=2e-3)
    assert bound_px(1e8, 1.2, 42.0, 0.01) > 5 * bound_px(1e8, 1.2, 42.0, 0.0)


def test_best_star_image_is_the_documents_half_pixel() -> None:
    """Noise and pixel bias together are least for Moniteq §4.2's pixel over σ of 2 to 2.5.

    Narrower star images are rated sharp.
    """
    c = DesignCamera.from_profile(shipped_camera("sunsat"))
    advice = psf_advice(c)
    assert 2.0 <= 1 / advice.best_px <= 3.0
    assert psf_advice(replace(c, psf_sigma_px=0.3)).kind == "sharp"
    assert psf_advice(replace(c, psf_sigma_px=0.5)).kind == "good"
    assert advice.kind == "wide"
    assert float(centroid_sigma_px(c, 3.0)) < float(centroid_sigma_px(c, 6.0))


def test_dark_current_may_fill_the_converter() -> None:
    """Erlank §3.4.4: 1008 counts per second fill the converter's 4096 in 4.06 s. Then every star saturates."""
    c = replace(
        DesignCamera.from_profile(shipped_camera("cubestar")),
        bits=12,
        gain_e_per_dn=1.0,
        bias_dn=0.0,
        dark_current_e_s=1008.0,
        background_e_s=0.0,
    )
    assert r.longest_exposure_s(c) == pytest.approx(4.06, abs=0.01)
    assert r.saturation_mag(replace(c, exposure_s=5.0)) == float("inf")
    assert isinstance(c, DesignCamera)
