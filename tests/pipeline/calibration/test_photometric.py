"""Magnitudes calibrated from rendered stars against the sensor that drew them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from gss.domain.camera_profile import CameraProfile
from gss.domain.errors import BadInput
from gss.instruments.registry import shipped_registry
from gss.pipeline.calibration.apply import calibrated_profile
from gss.pipeline.calibration.histogram import histogram
from gss.pipeline.calibration.photometric import ILLUMINANCE_V0_LUX, calibrate_photometry
from gss.pipeline.calibration.robust import fit_linear
from gss.pipeline.calibration.sightings import FrameStars

Known = Callable[[str], CameraProfile]
Night = Callable[..., list[FrameStars]]


def _lit(
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
    """Fluxes by the law: V = −2.5 log(flux / exposure) + zero + colour·(B−V), light 1 − loss·ρ²; ``power``: not linear."""
    made = []
    for f in frames:
        rho2 = ((f.pixels - [(f.columns - 1) / 2, (f.rows - 1) / 2]) ** 2).sum(axis=1) / (
            (f.columns**2 + f.rows**2) / 4
        )
        b_v = np.where(np.isfinite(f.b_v), f.b_v, 0.6)
        m = f.v_mag - zero - colour * b_v + sigma_mag * rng.normal(size=len(f))
        flux = exposure_s * (10 ** (-0.4 * m)) ** power * (1 - loss * rho2)
        made.append(
            replace(f, flux_dn=flux, peak_dn=flux * 0.1, area_px=np.full(len(f), 9, np.int32), exposure_s=exposure_s)
        )
    return made


@pytest.mark.parametrize("name", [i.name for i in shipped_registry().all() if i.profile.chain])
def test_zero_point_of_every_profile_is_found_in_pixels(name: str, rendered: Callable, known: Known) -> None:
    """From rendered frames, electrons of V = 0 within 4 %, and magnitudes scatter by less than a tenth."""
    own = known(name)
    frames, _ = rendered(name)
    # Near the limit only stars that noise made brighter are found.
    limits = own.sensor.bright_limit_mag, own.sensor.faint_limit_mag - 0.5
    made = calibrate_photometry(frames, own.camera, gain_e_per_dn=own.sensor.gain_e_per_dn, limits_mag=limits)
    assert made.zero_point_e_s == pytest.approx(own.sensor.zero_point_e_s, rel=0.04)
    assert made.robust_sigma_mag < 0.12
    assert made.colour_mag_per_mag == pytest.approx(0.0, abs=0.05)
    new = calibrated_profile(own, photometry=made).sensor
    assert new.zero_point_e_s == pytest.approx(made.zero_point_e_s)


def test_every_term_is_recovered_within_its_error(night: Night, known: Known) -> None:
    """Zero point, colour and vignetting come back; k_illum is that of eq. C.2; the scatter is what was put in."""
    camera = replace(known("cubestar").camera, centre_col_px=511.5, centre_row_px=255.5)
    rng = np.random.default_rng(1)
    frames = _lit(night(camera, limit_mag=5.5), 12.0, rng, colour=0.25, loss=0.3, sigma_mag=0.05)
    made = calibrate_photometry(frames, camera, gain_e_per_dn=5.0)
    assert abs(made.zero_point_mag - 12.0) < max(4 * made.zero_point_sigma_mag, 0.01)
    assert made.zero_point_sigma_mag < 0.02
    assert abs(made.colour_mag_per_mag - 0.25) < 4 * made.colour_sigma
    assert made.corner_loss == pytest.approx(0.3, abs=0.03)
    assert made.zero_point_e_s == pytest.approx(5 * 10 ** (0.4 * 12.0), rel=0.03)
    v5 = 0.5 * 10 ** (0.4 * (12.0 - 5.0))
    assert made.k_illum_lux_per_dn * v5 == pytest.approx(ILLUMINANCE_V0_LUX * 10**-2, rel=0.03)
    assert made.sigma_mag == pytest.approx(0.05, rel=0.1)
    assert made.histogram.counts.sum() == made.used.sum()
    assert np.diff(made.histogram.edges) == pytest.approx(0.1)
    assert made.linearity == pytest.approx(1.0, abs=0.01)
    assert made.magnitude(np.array([v5]), 0.5, 0.0) == pytest.approx([5.0], abs=0.02)
    assert made.warnings == ()


def test_area_factor_corrects_the_loss_below_a_threshold(night: Night, known: Known) -> None:
    """Brightness above a threshold that changes from frame to frame: k_area of eq. C.1 is found, and the scatter shrinks."""
    camera, rng = known("cubestar").camera, np.random.default_rng(3)
    frames, thresholds = [], []
    for k, f in enumerate(_lit(night(camera, limit_mag=5.0), 12.0, rng, sigma_mag=0.02)):
        level = float(k % 5)
        area = np.rint(np.clip(4 * np.log(f.flux_dn), 4, None)).astype(np.int32)
        frames.append(replace(f, flux_dn=f.flux_dn - 1.7 * area * level, area_px=area))
        thresholds.append(level)
    good = [(f, t) for f, t in zip(frames, thresholds, strict=True) if (f.flux_dn > 0).all()]
    frames, thresholds = [f for f, _ in good], [t for _, t in good]
    made = calibrate_photometry(frames, camera, threshold_above_dark_dn=thresholds)
    assert made.k_area == pytest.approx(1.7, abs=max(0.1, 4 * made.k_area_sigma))
    without = calibrate_photometry(frames, camera)
    assert made.sigma_mag < 0.7 * without.sigma_mag
    with pytest.raises(BadInput, match="one threshold per frame"):
        calibrate_photometry(frames, camera, threshold_above_dark_dn=[1.0])


def test_photometric_faults_are_reported(night: Night, known: Known) -> None:
    """Clipped stars, a cloud, a nonlinear converter: each gives a warning and shifts the zero point by at most 0.05."""
    camera, rng = known("cubestar").camera, np.random.default_rng(5)
    frames = _lit(night(camera, limit_mag=5.5), 12.0, rng)
    limit = 0.1 * 0.5 * 10 ** (0.4 * (12.0 - 4.0))  # peaks of V 4
    clipped = [
        replace(f, peak_dn=np.minimum(f.peak_dn, limit), flux_dn=np.minimum(f.flux_dn, 10 * limit), saturation_dn=limit)
        for f in frames
    ]
    made = calibrate_photometry(clipped, camera)
    assert "saturated" in {w.code for w in made.warnings}
    assert made.zero_point_mag == pytest.approx(12.0, abs=0.05)
    assert made.saturation_mag == pytest.approx(4.0, abs=0.15)
    cloudy = [replace(f, flux_dn=f.flux_dn * (0.4 if k in (3, 4) else 1)) for k, f in enumerate(frames)]
    made = calibrate_photometry(cloudy, camera)
    assert "clouds" in {w.code for w in made.warnings}
    assert made.frame_offset_mag[3] == pytest.approx(-1.0, abs=0.1)
    assert made.zero_point_mag == pytest.approx(12.0, abs=0.05)
    bent = _lit(night(camera, limit_mag=5.5), 12.0, rng, power=0.9)
    made = calibrate_photometry(bent, camera)
    assert "linearity" in {w.code for w in made.warnings}
    assert made.linearity == pytest.approx(0.9, abs=0.02)
    with pytest.raises(BadInput, match="too few stars"):
        calibrate_photometry(night(camera, frames=5), camera)


def test_outliers_do_not_shift_a_robust_line() -> None:
    """Ten percent of outliers move the line by less than its σ, and σ is that of the other points."""
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
    """No value falls out at the ends; the curve has the same area; nothing gives an empty one."""
    values = np.random.default_rng(0).normal(1.0, 0.3, 5000)
    made = histogram(values, "error, mag", 0.1)
    assert made.counts.sum() == 5000
    assert made.edges[0] <= values.min()
    assert made.edges[-1] >= values.max()
    assert made.normal.sum() == pytest.approx(5000, rel=0.01)
    assert np.abs(made.normal - made.counts).max() < 5 * np.sqrt(made.counts.max())
    assert histogram(np.array([np.nan]), "x").counts.sum() == 0
    assert histogram(np.zeros(7), "x").counts.sum() == 7
