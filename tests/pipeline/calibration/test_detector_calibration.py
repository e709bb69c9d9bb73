"""Dark frames, photon transfer, dark current by temperature, and star widths, compared with the simulated detector."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from gss.domain.camera import Camera
from gss.domain.camera_profile import CameraProfile
from gss.domain.errors import BadInput
from gss.domain.sensor import Defects, Sensor
from gss.instruments.registry import shipped_registry
from gss.pipeline.calibration.apply import calibrated_profile, detector_figures
from gss.pipeline.calibration.dark import calibrate_dark, pixel_response
from gss.pipeline.calibration.dark_temperature import EXPONENT_K, dark_against_temperature
from gss.pipeline.calibration.focus import best_focus, centroid_error_px, focus_advice, interpolation_error_px
from gss.pipeline.calibration.photon_transfer import FlatPair, photon_transfer
from gss.pipeline.calibration.psf_field import psf_over_field
from gss.pipeline.calibration.robust import fit_linear
from gss.pipeline.chip import Chip, make_chip
from gss.pipeline.readout import expose
from gss.pipeline.render import spots

ProfileOf = Callable[[str], CameraProfile]
SIZE = (200, 260)


def _small(profile: CameraProfile) -> Camera:
    return replace(profile.camera, columns=SIZE[1], rows=SIZE[0], centre_col_px=129.5, centre_row_px=99.5)


def _chip(profile: CameraProfile, **changes: float) -> Chip:
    return make_chip(replace(profile.defects, corner_loss=0.0, **changes), profile.sensor, _small(profile), 7)


def _expose(
    level_e: float, sensor: Sensor, exposure_s: float, rng: np.random.Generator, chip: Chip | None
) -> np.ndarray:
    return expose(np.full(SIZE, level_e), sensor, exposure_s, rng, chip=chip)


FINE_STEPS = [
    i.name
    for i in shipped_registry().all()
    if i.profile.chain and i.profile.sensor.read_noise_e > i.profile.sensor.gain_e_per_dn / 4
]
"""Cameras whose noise exceeds a quarter of a converter step. Coarser steps hide the noise."""


@pytest.mark.parametrize("name", FINE_STEPS)
def test_photon_transfer_finds_gain_and_noise_of_every_profile(name: str, profile_of: ProfileOf) -> None:
    """Gain is found within 2 %, read noise within 5 %, bias within half a step, and full well if the highest level
    exceeds it.
    """
    profile = profile_of(name)
    sensor, rng, chip = profile.sensor, np.random.default_rng(3), _chip(profile, dead_share=0.0)
    top_e = min(sensor.full_well_e, (sensor.saturation_dn - sensor.bias_dn) * sensor.gain_e_per_dn)

    def pair(level_e: float, exposure_s: float = 1e-4) -> FlatPair:
        return FlatPair(*(_expose(level_e, sensor, exposure_s, rng, chip) for _ in range(2)))

    transfer = photon_transfer(
        [pair(top_e * s) for s in (0.05, 0.1, 0.2, 0.35, 0.5, 0.65, 1.5)], pair(0.0), sensor.saturation_dn
    )
    assert transfer.gain_e_per_dn == pytest.approx(sensor.gain_e_per_dn, rel=0.02)
    assert abs(transfer.gain_e_per_dn - sensor.gain_e_per_dn) < 5 * transfer.gain_sigma + 0.01 * sensor.gain_e_per_dn
    noise = np.hypot(sensor.read_noise_e, sensor.gain_e_per_dn / np.sqrt(12))
    assert transfer.read_noise_e == pytest.approx(noise, rel=0.05)
    assert transfer.bias_dn == pytest.approx(sensor.bias_dn, abs=0.5)
    assert transfer.response_sigma == pytest.approx(profile.defects.response_sigma, rel=0.25)
    assert not transfer.fitted[-1]
    assert transfer.full_well_e == pytest.approx(top_e, rel=0.05)
    calibrated_sensor = calibrated_profile(profile, detector=detector_figures(transfer)).sensor
    assert calibrated_sensor.gain_e_per_dn == transfer.gain_e_per_dn
    assert calibrated_sensor.zero_point_e_s == sensor.zero_point_e_s


def test_photon_transfer_without_a_dark_pair_gives_a_warning(profile_of: ProfileOf) -> None:
    """Without a dark pair, the gain is found, bias and read noise are NaN and not used for the camera, and a warning
    states the missing dark. Too few levels and frames of unequal size are rejected.
    """
    profile = profile_of("far_mst")
    sensor, rng = profile.sensor, np.random.default_rng(5)
    pairs = [
        FlatPair(*(_expose(e, sensor, 1e-4, rng, None) for _ in range(2))) for e in (500.0, 1500.0, 3000.0, 6000.0)
    ]
    transfer = photon_transfer(pairs)
    assert transfer.gain_e_per_dn == pytest.approx(10.0, rel=0.03)
    assert np.isnan([transfer.bias_dn, transfer.read_noise_e, transfer.read_noise_sigma_e]).all()
    assert calibrated_profile(profile, detector=detector_figures(transfer)).sensor.read_noise_e == sensor.read_noise_e
    assert {w.code for w in transfer.warnings} == {"no-dark", "no-full-well"}
    with pytest.raises(BadInput, match="too few levels"):
        photon_transfer(pairs[:2])
    with pytest.raises(BadInput, match="have different sizes"):
        photon_transfer([FlatPair(pairs[0].first, pairs[0].second[:50])])
    smooth = [FlatPair(*(gaussian_filter(f.astype(float), 2) for f in (p.first, p.second))) for p in pairs]
    assert photon_transfer(smooth).gain_e_per_dn > 50  # smoothed frames lack photon noise, so the gain is too high


def test_full_well_and_response_need_the_level_without_light() -> None:
    """With a bias of 30 DN and a full well of 6000 e, the full well and the response are measured from the dark level. They
    are NaN if it is unknown, also for a level that reaches saturation."""
    rng = np.random.default_rng(1)
    response = 1 + 0.01 * rng.normal(size=SIZE)

    def flat(level_e: float) -> np.ndarray:
        return np.rint(30 + np.minimum(rng.poisson(level_e * response), 6000) / 40 + rng.normal(0, 0.6, SIZE))

    pairs = [FlatPair(flat(e), flat(e)) for e in (300, 900, 1800, 3000, 4500, 5500, 6200, 7000)]
    unknown = photon_transfer(pairs, saturation_dn=255)
    assert np.isnan([unknown.full_well_e, unknown.response_sigma]).all()
    assert "no-full-well" not in {w.code for w in unknown.warnings}
    known = photon_transfer(pairs, saturation_dn=255, dark_dn=30.0)
    assert known.full_well_e == pytest.approx(6000, rel=0.03)
    assert known.response_sigma == pytest.approx(0.01, rel=0.1)
    assert np.isnan([known.bias_dn, known.read_noise_e]).all()
    assert known.gain_e_per_dn == pytest.approx(unknown.gain_e_per_dn)


def test_equal_frames_are_rejected_as_flats_and_give_no_read_noise() -> None:
    """A flat frame given twice is rejected with its number. A dark frame given twice gives the bias only."""
    rng = np.random.default_rng(1)

    def frame(level_e: float) -> np.ndarray:
        return np.rint(100 + rng.poisson(level_e, SIZE) / 2 + rng.normal(0, 1.5, SIZE))

    pairs = [FlatPair(frame(e), frame(e)) for e in (200, 500, 1000, 3000, 6000)]
    for k in (0, 2):
        twice = [FlatPair(p.first, p.first) if k == i else p for i, p in enumerate(pairs)]
        with pytest.raises(BadInput, match=f"equal.*pair {k + 1} "):
            photon_transfer(twice)
    dark = frame(0.0)
    transfer = photon_transfer(pairs, FlatPair(dark, dark))
    assert transfer.gain_e_per_dn == pytest.approx(2.0, rel=0.02)
    assert transfer.bias_dn == pytest.approx(100, abs=0.1)
    assert np.isnan(transfer.read_noise_e)
    with pytest.raises(BadInput, match="not positive"):
        fit_linear(np.ones((3, 1)), np.ones(3), np.array([1.0, 0.0, 1.0]))


@pytest.mark.parametrize("name", ["cubestar", "far_mst", "sunsat"])
def test_dark_frames_reveal_the_defects_of_the_chip(name: str, profile_of: ProfileOf) -> None:
    """The measured hot pixels, pattern and column offsets are those of the chip, and the level is bias plus dark
    current.
    """
    profile = profile_of(name)
    rng, exposure_s = np.random.default_rng(8), profile.sensor.exposure_s
    chip = _chip(profile, hot_share=1e-3)
    frames = [_expose(0.0, profile.sensor, exposure_s, rng, chip) for _ in range(24)]
    dark = calibrate_dark(frames, exposure_s)
    excess_dn = chip.dark_e_s.ravel()[chip.hot] * exposure_s / profile.sensor.gain_e_per_dn
    limit = 9 * max(np.hypot(dark.pattern_sigma_dn, dark.noise_dn / np.sqrt(24)), 0.3) + 1
    detectable = {divmod(int(i), SIZE[1])[::-1] for i in chip.hot[excess_dn > limit]}
    detected = set(map(tuple, dark.hot.tolist()))
    assert detectable <= detected
    assert detected <= {divmod(int(i), SIZE[1])[::-1] for i in chip.hot}
    assert list(dark.hot_excess_dn) == sorted(dark.hot_excess_dn, reverse=True)
    pattern = np.hypot(
        profile.defects.offset_sigma_dn,
        profile.defects.dark_sigma * profile.sensor.dark_current_e_s * exposure_s / profile.sensor.gain_e_per_dn,
    )
    assert dark.pattern_sigma_dn == pytest.approx(pattern, rel=0.2, abs=0.05)
    assert dark.column_sigma_dn == pytest.approx(profile.defects.column_sigma_dn, rel=0.25, abs=0.03)
    dark_e_s = profile.sensor.dark_current_e_s + profile.sensor.background_e_s
    assert dark.dark_e_s(profile.sensor.bias_dn, profile.sensor.gain_e_per_dn) == pytest.approx(
        dark_e_s, abs=1.2 * profile.sensor.gain_e_per_dn / exposure_s * 0.3
    )
    noise = profile.sensor.noise_e(exposure_s) / profile.sensor.gain_e_per_dn
    assert dark.noise_dn == pytest.approx(noise, rel=0.1, abs=0.1)
    assert dark.warnings == ()


def test_dark_frames_with_light_or_drift_are_reported(profile_of: ProfileOf) -> None:
    """A light leak, a warming camera and too few frames each give a warning. Frames of unequal size are rejected."""
    profile = profile_of("far_mst")
    rng = np.random.default_rng(1)
    frames = [_expose(0.0, profile.sensor, 0.1, rng, None) for _ in range(6)]
    leak = np.linspace(0, 40, SIZE[1]) * np.ones(SIZE)
    lit = [f + leak * np.linspace(0, 1, SIZE[0])[:, None] for f in frames]
    assert "light" in {w.code for w in calibrate_dark(lit, 0.1).warnings}
    warming = [f + 5 * k for k, f in enumerate(frames)]
    assert "drift" in {w.code for w in calibrate_dark(warming, 0.1).warnings}
    assert {w.code for w in calibrate_dark(frames[:3], 0.1).warnings} == {"few-frames"}
    with pytest.raises(BadInput, match="cannot be combined"):
        calibrate_dark([frames[0], frames[1][:20], frames[2]], 0.1)


def test_dead_pixels_and_response_are_found_from_flat_fields(profile_of: ProfileOf) -> None:
    """Flat fields give exactly the chip's dead pixels and its spread of response. An uneven lamp gives a warning;
    frames without light are rejected.
    """
    profile = profile_of("cubestar")
    chip, rng = _chip(profile, dead_share=5e-4), np.random.default_rng(4)
    flats = [_expose(600.0, profile.sensor, 1e-4, rng, chip) for _ in range(40)]
    response = pixel_response(flats, profile.sensor.bias_dn + chip.offset_dn)
    assert {tuple(p) for p in response.dead.tolist()} == {divmod(int(i), SIZE[1])[::-1] for i in chip.dead}
    assert response.response_sigma == pytest.approx(profile.defects.response_sigma, rel=0.4)
    slope = [f * np.linspace(0.3, 1.0, SIZE[1]) for f in flats]
    assert {w.code for w in pixel_response(slope, 0.0).warnings} == {"uneven"}
    with pytest.raises(BadInput, match="no light"):
        pixel_response([_expose(0.0, profile.sensor, 1e-4, rng, None) for _ in range(4)], 8.0)


def test_dark_current_follows_the_diode_law() -> None:
    """Values of eq. H.2 give its exponent, its band gap of 1.1 V, and the document's 44-fold decrease from 60 °C to 5
    °C. The stated σ agrees with the scatter of noisy values.
    """
    t = np.array([278.0, 290.0, 305.0, 320.0, 333.0])
    truth = 50.0 * np.exp(EXPONENT_K * (1 / 333.0 - 1 / t))
    law = dark_against_temperature(t, truth)
    assert law.exponent_k == pytest.approx(EXPONENT_K, rel=1e-9)
    assert law.band_gap_ev == pytest.approx(1.1, rel=0.002)
    assert law.dark_e_s(278.0) == pytest.approx(1.133, abs=0.001)
    assert law.dark_e_s(law.reference_k + law.doubling_k) / law.dark_e_s(law.reference_k) == pytest.approx(2, rel=0.03)
    rng = np.random.default_rng(0)
    scatter = np.array(
        [
            (m.exponent_k - EXPONENT_K) / m.exponent_sigma_k
            for m in (dark_against_temperature(t, truth * np.exp(0.05 * rng.normal(size=5))) for _ in range(200))
        ]
    )
    assert 0.7 < np.median(np.abs(scatter)) / 0.6745 < 1.6
    with pytest.raises(BadInput):
        dark_against_temperature(t[:2], truth[:2])
    with pytest.raises(BadInput):
        dark_against_temperature(t - 273, truth)
    assert {w.code for w in dark_against_temperature(t, np.full(5, 20.0) + t / 100).warnings} == {"law"}


def _starfield(sigma_of: Callable[[float, float], tuple[float, float]], rng: np.random.Generator) -> np.ndarray:
    """Return a 400 x 300 image of stars on an irregular grid. ``sigma_of`` gives the widths (σ along columns and rows)
    at a position.
    """
    image = np.full((300, 400), 20.0)
    for col in range(25, 380, 45):
        for row in range(25, 280, 45):
            x, y = col + rng.uniform(-8, 8), row + rng.uniform(-8, 8)
            wide, high = sigma_of(x, y)
            image += _elliptical(x, y, wide, high, 6000.0)
    return np.rint(rng.poisson(image)).astype(np.uint16)


def _elliptical(x: float, y: float, wide: float, high: float, light: float) -> np.ndarray:
    """Return a 300 x 400 image of one star with σ ``wide`` along columns and ``high`` along rows."""
    row = spots(1, 400, np.array([[x, 0.0]]), np.array([1.0]), wide)[0]
    across = row / row.sum()
    column = spots(300, 1, np.array([[0.0, y]]), np.array([1.0]), high)[:, 0]
    return light * np.outer(column / column.sum(), across)


def test_star_width_is_measured_over_the_field() -> None:
    """Uniform, curved and tilted focal surfaces and trails are distinguished. The stated σ is that of the optics,
    without the pixel.
    """
    camera, rng = Camera(400, 300, 800.0, 800.0, 199.5, 149.5), np.random.default_rng(6)
    uniform = psf_over_field([_starfield(lambda x, y: (1.3, 1.3), rng)], camera, e_per_dn=1.0)
    assert uniform.typical_sigma_px == pytest.approx(1.3, rel=0.02)
    assert uniform.warnings == ()
    assert np.median(uniform.ratio) < 1.1
    assert np.nanmax(uniform.map.rms_px) == pytest.approx(1.3, rel=0.1)

    def curved(x: float, y: float) -> tuple[float, float]:
        sigma = float(np.sqrt(1.0 + 2.0 * ((x - 199.5) ** 2 + (y - 149.5) ** 2) / 250**2))
        return sigma, sigma

    curved_field = psf_over_field([_starfield(curved, rng) for _ in range(2)], camera, e_per_dn=1.0)
    assert curved_field.centre_sigma_px == pytest.approx(1.0, rel=0.05)
    assert curved_field.corner_sigma_px == pytest.approx(np.sqrt(3.0), rel=0.07)
    assert {w.code for w in curved_field.warnings} == {"curvature"}

    def tilted(x: float, _: float) -> tuple[float, float]:
        sigma = float(np.sqrt(1.5 + (x - 199.5) / 250))
        return sigma, sigma

    assert {w.code for w in psf_over_field([_starfield(tilted, rng)], camera, e_per_dn=1.0).warnings} == {"tilt"}
    trailed = psf_over_field([_starfield(lambda x, y: (1.9, 1.1), rng)], camera, e_per_dn=1.0)
    assert "streaks" in {w.code for w in trailed.warnings}
    assert np.median(trailed.ratio) == pytest.approx(1.9 / 1.1, rel=0.05)
    assert np.median(np.abs((trailed.direction_rad + 0.5) % np.pi - 0.5)) < 0.1
    with pytest.raises(BadInput, match="too few bright stars"):
        psf_over_field([rng.poisson(20, (300, 400)).astype(np.uint16)], camera)


def test_focus_advice_agrees_with_the_documents() -> None:
    """Sampling errors and the best ratio of pixel to σ agree with Moniteq. As in Huffman's work, the best width
    decreases with noise.
    """
    assert interpolation_error_px(1 / 2.35, 3) == pytest.approx(
        0.0107, abs=0.001
    )  # dossier 3.8: the best rms with three pixels
    assert interpolation_error_px(1 / 1.96, 4) < 0.005
    assert 0.23 < interpolation_error_px(0.05, 3) < 1 / np.sqrt(12)  # a point source illuminates one pixel
    assert focus_advice(0.43).verdict == "good"
    assert focus_advice(0.2).verdict == "sharp"
    assert "defocus" in focus_advice(0.2).hint
    assert focus_advice(2.5).verdict == "soft"
    bright, faint = focus_advice(1.0, 100.0), focus_advice(1.0, 2.0)
    assert bright.error_px < faint.error_px
    assert faint.best_sigma_px < bright.best_sigma_px
    assert centroid_error_px(5.0, 3.0)[0] > 3 * centroid_error_px(0.6, 3.0)[0]
    with pytest.raises(BadInput):
        focus_advice(0.0)


def test_best_focus_is_the_minimum_of_a_parabola() -> None:
    """Star widths at several focus settings give the best setting, and the two settings with the requested width."""
    rng = np.random.default_rng(2)
    x = np.linspace(-3, 4, 15)
    sigma = np.sqrt(0.36 + 0.25 * (x - 0.7) ** 2) * (1 + 0.01 * rng.normal(size=15))
    focus = best_focus(x, sigma, 0.9)
    assert focus.position == pytest.approx(0.7, abs=0.05)
    assert focus.smallest_sigma_px == pytest.approx(0.6, rel=0.05)
    assert focus.wished_positions[1] - focus.position == pytest.approx(np.sqrt((0.81 - 0.36) / 0.25), rel=0.05)
    assert np.isnan(best_focus(x, sigma, 0.2).wished_positions).all()
    with pytest.raises(BadInput):
        best_focus(x, 10 - sigma)


def test_a_perfect_chip_has_no_pattern(profile_of: ProfileOf) -> None:
    """A chip without defects gives no hot pixels and no pattern, although the frames are noisy."""
    profile = profile_of("far_mst")
    rng, chip = np.random.default_rng(2), make_chip(Defects(), profile.sensor, _small(profile), 1)
    dark = calibrate_dark([_expose(0.0, profile.sensor, 0.1, rng, chip) for _ in range(20)], 0.1)
    assert len(dark.hot) == 0
    assert len(dark.noisy) == 0
    assert dark.pattern_sigma_dn < 0.3
    assert dark.column_sigma_dn < 0.1
