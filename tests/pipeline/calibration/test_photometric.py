"""Photometric calibration from rendered stars, compared with the sensor that rendered them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from gss.domain.camera import Camera
from gss.domain.camera_profile import CameraProfile
from gss.domain.errors import BadInput
from gss.instruments.registry import shipped_registry
from gss.pipeline.calibration.apply import calibrated_profile
from gss.pipeline.calibration.histogram import histogram
from gss.pipeline.calibration.photometric import ILLUMINANCE_V0_LUX, calibrate_photometry, corner_radius
from gss.pipeline.calibration.robust import fit_linear, robust_sigma
from gss.pipeline.calibration.sightings import FrameStars

ProfileOf = Callable[[str], CameraProfile]
StarFrames = Callable[..., list[FrameStars]]


def _with_flux(
    frames: list[FrameStars],
    zero: float,
    rng: np.random.Generator,
    *,
    colour: float = 0.0,
    sigma_mag: float = 0.05,
    loss: float = 0.0,
    power: float = 1.0,
    exposure_s: float = 0.5,
) -> list[FrameStars]:
    """Return frames with fluxes by the law V = −2.5 log(flux / exposure) + zero + colour·(B−V). The light decreases
    towards the corner as 1 − loss·ρ². A ``power`` other than 1 simulates a nonlinear converter.
    """
    with_flux = []
    for frame in frames:
        rho2 = ((frame.pixels - [(frame.columns - 1) / 2, (frame.rows - 1) / 2]) ** 2).sum(axis=1) / (
            (frame.columns**2 + frame.rows**2) / 4
        )
        b_v = np.where(np.isfinite(frame.b_v), frame.b_v, 0.6)
        magnitude = frame.v_mag - zero - colour * b_v + sigma_mag * rng.normal(size=len(frame))
        flux = exposure_s * (10 ** (-0.4 * magnitude)) ** power * (1 - loss * rho2)
        with_flux.append(
            replace(
                frame, flux_dn=flux, peak_dn=flux * 0.1, area_px=np.full(len(frame), 9, np.int32), exposure_s=exposure_s
            )
        )
    return with_flux


@pytest.mark.parametrize("name", [i.name for i in shipped_registry().all() if i.profile.chain])
def test_zero_point_of_every_profile_is_found_from_rendered_frames(
    name: str, rendered: Callable, profile_of: ProfileOf
) -> None:
    """The electrons per second of a star of V = 0 are found within 4 %, and magnitudes scatter by less than 0.12."""
    profile = profile_of(name)
    frames, _ = rendered(name)
    # Near the limit, only stars that noise makes brighter are detected, which would bias the zero point.
    limits = profile.sensor.bright_limit_mag, profile.sensor.faint_limit_mag - 0.5
    calibration = calibrate_photometry(
        frames, profile.camera, gain_e_per_dn=profile.sensor.gain_e_per_dn, limits_mag=limits
    )
    assert calibration.zero_point_e_s == pytest.approx(profile.sensor.zero_point_e_s, rel=0.04)
    assert calibration.robust_sigma_mag < 0.12
    assert calibration.colour_mag_per_mag == pytest.approx(0.0, abs=0.05)
    calibrated_sensor = calibrated_profile(profile, photometry=calibration).sensor
    assert calibrated_sensor.zero_point_e_s == pytest.approx(calibration.zero_point_e_s)


def test_every_term_is_recovered_within_its_error(star_frames: StarFrames, profile_of: ProfileOf) -> None:
    """Zero point, colour and vignetting are recovered. k_illum is that of eq. C.2, and the scatter is the simulated
    one.
    """
    camera = replace(profile_of("cubestar").camera, centre_col_px=511.5, centre_row_px=255.5)
    rng = np.random.default_rng(1)
    frames = _with_flux(star_frames(camera, limit_mag=5.5), 12.0, rng, colour=0.25, loss=0.3, sigma_mag=0.05)
    calibration = calibrate_photometry(frames, camera, gain_e_per_dn=5.0)
    assert abs(calibration.zero_point_mag - 12.0) < max(4 * calibration.zero_point_sigma_mag, 0.01)
    assert calibration.zero_point_sigma_mag < 0.02
    assert abs(calibration.colour_mag_per_mag - 0.25) < 4 * calibration.colour_sigma
    assert calibration.corner_loss == pytest.approx(0.3, abs=0.03)
    assert calibration.zero_point_e_s == pytest.approx(5 * 10 ** (0.4 * 12.0), rel=0.03)
    v5 = 0.5 * 10 ** (0.4 * (12.0 - 5.0))
    assert calibration.k_illum_lux_per_dn * v5 == pytest.approx(ILLUMINANCE_V0_LUX * 10**-2, rel=0.03)
    assert calibration.sigma_mag == pytest.approx(0.05, rel=0.1)
    assert calibration.histogram.counts.sum() == calibration.used.sum()
    assert np.diff(calibration.histogram.edges) == pytest.approx(0.1)
    assert calibration.linearity == pytest.approx(1.0, abs=0.01)
    assert calibration.magnitude(np.array([v5]), 0.5, 0.0) == pytest.approx([5.0], abs=0.02)
    assert calibration.warnings == ()


CAMERA = Camera(1000, 1000, 2000.0, 2000.0, 499.5, 499.5)


def random_frames(
    rng: np.random.Generator,
    *,
    count: int = 12,
    edge: float = 1.0,
    rho2_mag: float = 0.0,
    rho4_mag: float = 0.0,
    haze_mag: float = 0.0,
) -> list[FrameStars]:
    """Return frames of 40 random stars each with a scatter of 0.05 mag and vignetting by a polynomial in magnitudes.
    ``edge``: part of the half width of the detector that has stars. ``haze_mag``: scatter of the light of the frames."""
    frames = []
    for k in range(count):
        n = 40
        pixels = 499.5 + 500 * edge * rng.uniform(-1, 1, (n, 2))
        v_mag, b_v = rng.uniform(2, 6, n), rng.uniform(-0.2, 1.6, n)
        rho = np.hypot(*(pixels - 499.5).T) / corner_radius(CAMERA)
        lost_mag = rho2_mag * rho**2 + rho4_mag * rho**4 + 0.05 * rng.normal(size=n)
        flux = 1e6 * 10 ** (-0.4 * (v_mag + lost_mag + haze_mag * rng.normal()))
        icrs, area = np.tile([1.0, 0.0, 0.0], (n, 1)), np.full(n, 9, np.int32)
        hip = np.arange(1, n + 1, dtype=np.int32)
        frames.append(
            FrameStars(f"{k}", 1000, 1000, pixels, np.full(n, 0.1), icrs, hip, v_mag, b_v, flux, 0.1 * flux, area, 1.0)
        )
    return frames


def test_the_sigma_of_the_corner_loss_is_its_error() -> None:
    """The σ of the light lost in the corner, from two strongly correlated coefficients, agrees with its scatter. If no
    star is near a corner, the σ is NaN."""
    rng = np.random.default_rng(4)
    fits = [calibrate_photometry(random_frames(rng, rho2_mag=0.2, rho4_mag=0.6), CAMERA) for _ in range(100)]
    losses = np.array([f.corner_loss for f in fits])
    # In a few runs, too few stars are near the corners to fit both coefficients, and the loss is smaller.
    assert np.median(losses) == pytest.approx(1 - 10 ** (-0.4 * 0.8), abs=0.005)
    assert np.median([f.corner_loss_sigma for f in fits]) / robust_sigma(losses) == pytest.approx(1, abs=0.3)
    middle = calibrate_photometry(random_frames(rng, edge=0.3), CAMERA)
    assert middle.corner_loss == 0
    assert np.isnan(middle.corner_loss_sigma)


@pytest.mark.parametrize("haze_mag", [0.0, 0.1])
def test_the_sigma_of_the_zero_point_includes_haze(haze_mag: float) -> None:
    """The σ of the zero point agrees with its scatter, with and without differences between the frames."""
    rng = np.random.default_rng(8)
    fits = [calibrate_photometry(random_frames(rng, count=10, haze_mag=haze_mag), CAMERA) for _ in range(100)]
    ratio = np.median([f.zero_point_sigma_mag for f in fits]) / np.std([f.zero_point_mag for f in fits])
    assert ratio == pytest.approx(1, abs=0.25)


def test_area_factor_corrects_the_loss_below_a_threshold(star_frames: StarFrames, profile_of: ProfileOf) -> None:
    """If brightness is measured above a threshold that changes between frames, k_area of eq. C.1 is found, and
    correcting for it reduces the scatter.
    """
    camera, rng = profile_of("cubestar").camera, np.random.default_rng(3)
    frames, thresholds = [], []
    for k, f in enumerate(_with_flux(star_frames(camera, limit_mag=5.0), 12.0, rng, sigma_mag=0.02)):
        level = float(k % 5)
        area = np.rint(np.clip(4 * np.log(f.flux_dn), 4, None)).astype(np.int32)
        frames.append(replace(f, flux_dn=f.flux_dn - 1.7 * area * level, area_px=area))
        thresholds.append(level)
    positive = [(f, t) for f, t in zip(frames, thresholds, strict=True) if (f.flux_dn > 0).all()]
    frames, thresholds = [f for f, _ in positive], [t for _, t in positive]
    calibration = calibrate_photometry(frames, camera, threshold_above_dark_dn=thresholds)
    assert calibration.k_area == pytest.approx(1.7, abs=max(0.1, 4 * calibration.k_area_sigma))
    uncorrected = calibrate_photometry(frames, camera)
    assert calibration.sigma_mag < 0.7 * uncorrected.sigma_mag
    with pytest.raises(BadInput, match="the number of thresholds differs from the number of frames"):
        calibrate_photometry(frames, camera, threshold_above_dark_dn=[1.0])


def test_a_negative_area_factor_is_not_fitted(star_frames: StarFrames, profile_of: ProfileOf) -> None:
    """If the fitted k_area is negative, it is 0, and the zero point is that of a fit without it."""
    camera, rng = profile_of("cubestar").camera, np.random.default_rng(3)
    frames = []
    for f in _with_flux(star_frames(camera, limit_mag=5.0), 12.0, rng):
        area = np.rint(np.clip(4 * np.log(f.flux_dn), 4, None)).astype(np.int32)
        frames.append(replace(f, flux_dn=f.flux_dn + 2 * area, area_px=area))
    calibration = calibrate_photometry(frames, camera, threshold_above_dark_dn=3.0)
    without = calibrate_photometry(frames, camera)
    assert calibration.k_area == 0
    assert np.isnan(calibration.k_area_sigma)
    assert calibration.zero_point_mag == without.zero_point_mag
    assert calibration.error_mag[calibration.used].mean() == pytest.approx(0, abs=0.01)


def test_photometric_faults_are_reported(star_frames: StarFrames, profile_of: ProfileOf) -> None:
    """Clipped stars, a cloud and a nonlinear converter each give a warning. The first two change the zero point by at
    most 0.05 mag.
    """
    camera, rng = profile_of("cubestar").camera, np.random.default_rng(5)
    frames = _with_flux(star_frames(camera, limit_mag=5.5), 12.0, rng)
    limit = 0.1 * 0.5 * 10 ** (0.4 * (12.0 - 4.0))  # peaks of V 4
    clipped = [
        replace(f, peak_dn=np.minimum(f.peak_dn, limit), flux_dn=np.minimum(f.flux_dn, 10 * limit), saturation_dn=limit)
        for f in frames
    ]
    calibration = calibrate_photometry(clipped, camera)
    assert "saturated" in {w.code for w in calibration.warnings}
    assert calibration.zero_point_mag == pytest.approx(12.0, abs=0.05)
    assert calibration.saturation_mag == pytest.approx(4.0, abs=0.15)
    cloudy = [replace(f, flux_dn=f.flux_dn * (0.4 if k in (3, 4) else 1)) for k, f in enumerate(frames)]
    calibration = calibrate_photometry(cloudy, camera)
    assert "clouds" in {w.code for w in calibration.warnings}
    assert calibration.frame_offset_mag[3] == pytest.approx(-1.0, abs=0.1)
    assert calibration.zero_point_mag == pytest.approx(12.0, abs=0.05)
    nonlinear = _with_flux(star_frames(camera, limit_mag=5.5), 12.0, rng, power=0.9)
    calibration = calibrate_photometry(nonlinear, camera)
    assert "linearity" in {w.code for w in calibration.warnings}
    assert calibration.linearity == pytest.approx(0.9, abs=0.02)
    with pytest.raises(BadInput, match="too few stars"):
        calibrate_photometry(star_frames(camera, frames=5), camera)


def test_outliers_do_not_shift_a_robust_line() -> None:
    """Ten per cent of outliers are excluded. The line is recovered within 3.5 σ, and the stated σ is that of the other
    points.
    """
    rng = np.random.default_rng(2)
    x = np.linspace(0, 1, 300)
    y = 2 + 3 * x + 0.1 * rng.normal(size=300)
    y[::10] += 5
    fit = fit_linear(np.column_stack([np.ones(300), x]), y)
    sigma = np.sqrt(np.diag(fit.covariance))
    assert np.all(np.abs(fit.coefficients - [2, 3]) < 3.5 * sigma)
    assert fit.sigma == pytest.approx(0.1, rel=0.1)
    assert not fit.used[::10].any()
    with pytest.raises(BadInput):
        fit_linear(np.ones((2, 2)), np.ones(2))


def test_histogram_holds_every_value_and_its_normal_curve() -> None:
    """The histogram counts every value, and the normal curve has the same area. Without values it is empty."""
    values = np.random.default_rng(0).normal(1.0, 0.3, 5000)
    counted = histogram(values, "error, mag", 0.1)
    assert counted.counts.sum() == 5000
    assert counted.edges[0] <= values.min()
    assert counted.edges[-1] >= values.max()
    assert counted.normal.sum() == pytest.approx(5000, rel=0.01)
    assert np.abs(counted.normal - counted.counts).max() < 5 * np.sqrt(counted.counts.max())
    assert histogram(np.array([np.nan]), "x").counts.sum() == 0
    assert histogram(np.zeros(7), "x").counts.sum() == 7
