"""The documents' formulas give the numbers that the documents print."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gss.catalogue_tools.design import limits_erlank, limits_huffman, limits_jacobs, limits_moniteq, stray_light
from gss.catalogue_tools.design.camera import DesignCamera
from gss.instruments.registry import shipped_camera

ICX = replace(DesignCamera.from_profile(shipped_camera("sunsat")), transmission=1.0, exposure_s=1.0, psf_sigma_px=1.5)


def edge_mv(sigma_px: float) -> float:
    """Return the curve of Fig. 9-4: the signal of the edge pixel of a V 6 star in mV, reduced by the margin of 3 dB."""
    camera = replace(ICX, psf_sigma_px=sigma_px)
    return 1e3 * limits_jacobs.edge_v(camera, 6.0) / limits_jacobs.MARGIN


def test_responsivity_and_dark_pattern_of_jacobs_are_reproduced() -> None:
    """Eq. H.4 gives 1.385 V/(lx s), eq. 9.8 gives 1.133 mV, and eq. C.4 gives 1.05e-8 lx."""
    assert limits_jacobs.ICX059.responsivity_v_lx_s == pytest.approx(1.385, abs=5e-4)
    assert 1e3 * limits_jacobs.dsnu_v(1.0) == pytest.approx(1.133, abs=5e-4)
    assert limits_jacobs.star_lux(6.0) == pytest.approx(1.05e-8, rel=5e-3)


def test_star_widths_permitted_by_jacobs_are_reproduced() -> None:
    """The peak of Fig. 9-4 is 1.6 mV, and the curve is above 1.133 mV for σ of about 1 to 2.5 px (§9.2.2)."""
    sigma = np.arange(0.5, 4.0, 0.01)
    curve = np.array([edge_mv(float(s)) for s in sigma])
    above = sigma[curve > 1.133]
    assert curve.max() == pytest.approx(1.6, abs=0.1)
    assert above[0] == pytest.approx(1.0, abs=0.05)
    assert above[-1] == pytest.approx(2.5, abs=0.05)


def test_limit_of_jacobs_equates_edge_pixel_and_dark_pattern() -> None:
    """At the limiting magnitude, both sides of eq. 9.16 are equal. The limit is fainter than V 6 for the document's
    star and independent of the exposure.
    """
    limit = limits_jacobs.limit_mag(ICX)
    assert limits_jacobs.edge_v(ICX, limit) / limits_jacobs.MARGIN == pytest.approx(limits_jacobs.dsnu_v(1.0))
    assert 6.0 < limit < 6.6
    assert limits_jacobs.limit_mag(replace(ICX, exposure_s=0.1)) == pytest.approx(limit)


def test_noise_and_ratios_of_huffman_are_reproduced() -> None:
    """Eq. 3.18 without the superfluous gain gives the noise of Table 4.1, and the ratios that the dossier calculates
    for Table 7.1.
    """
    table_4_1 = limits_huffman.HuffmanImager(np.pi * 1e-4, 0.1, 2.5, 41, 40)
    assert table_4_1.noise_e == pytest.approx(40.51, abs=0.01)
    table_7_1 = limits_huffman.HuffmanImager(1.77e-4, 0.1, 2.5, 41, 39)
    for v, electrons, ratio in ((0, 336_631, 216.9), (3, 21_240, 13.7), (6, 1_340, 0.86)):
        assert limits_huffman.star_e(table_7_1, v) == pytest.approx(electrons, rel=5e-4)
        assert limits_huffman.snr(table_7_1, v) == pytest.approx(ratio, rel=5e-3)
    assert limits_huffman.magnitude(table_7_1, limits_huffman.star_e(table_7_1, 4.2)) == pytest.approx(4.2)


def test_huffman_limit_reaches_the_threshold() -> None:
    """The SNR of a star at the limit is the camera's threshold."""
    camera = DesignCamera.from_profile(shipped_camera("far_mst"))
    imager = limits_huffman.imager_of(camera)
    assert limits_huffman.snr(imager, limits_huffman.limit_mag(camera)) == pytest.approx(camera.threshold_snr)


def test_photons_and_fields_of_erlank_are_reproduced() -> None:
    """The formulas give 6.733e10 and 21 115 photons (§3.4.4), and the fields of Table 3.5: 51.6° x 27.28° and a circle
    of 42.33° for 6 mm, 54° x 28.6° and 44.34° for 5.7 mm.
    """
    assert limits_erlank.photons_s(25e-9) == pytest.approx(6.733e10, rel=1e-4)
    assert limits_erlank.needed_photons_s(5.6, 5.6) == pytest.approx(21_115, abs=1)
    for focal, across, down, circle in ((6.0, 51.6, 27.28, 42.33), (5.7, 54.0, 28.6, 44.34)):
        fov = [limits_erlank.fov_rad(size, focal) for size in (5.8016, 2.9120)]
        assert np.degrees(fov) == pytest.approx([across, down], abs=0.06)
        assert np.degrees(limits_erlank.equal_circle_rad(*fov)) == pytest.approx(circle, abs=0.05)


def test_printed_limit_of_erlank_requires_less_than_two_pixels() -> None:
    """With the inputs of the text, the limit for 3 x 3 pixels is V 3.68 instead of the printed 5.5. It is 5.5 for 1.7
    pixels and 6.07 for one.
    """
    needed = limits_erlank.needed_photons_s(5.6, 5.6)
    limits = [limits_erlank.limit_of_lens_mag(limits_erlank.Lens(), needed, n) for n in (1, 1.69, 9, 25)]
    assert limits == pytest.approx([6.07, 5.50, 3.68, 2.57], abs=0.005)
    assert [limits_erlank.pixels_covered(s) for s in (0.4, 1.2, 2.0)] == [1, 9, 25]


def test_signal_to_noise_ratio_of_moniteq_is_reproduced() -> None:
    """The S/N for the 50 mm lens in 4 s is 280 (§4.4)."""
    detector = limits_moniteq.MoniteqDetector()
    assert limits_moniteq.snr(detector, 10.0, 6.0, 4.0) == pytest.approx(280, rel=0.02)


def test_stray_light_tables_of_moniteq_are_reproduced() -> None:
    """The formulas give Table 5.2 (1.46e-6 cm² sr, 9.5e14 and 2.0e10 e/s) and every row of Table 5.3."""
    etendue = stray_light.pixel_etendue_cm2_sr(20, 20, 1.4)
    assert etendue == pytest.approx(1.46e-6, rel=5e-3)
    # The printed radiance uses the diameter of the Sun as its radius (errata).
    printed_sun = replace(stray_light.SUN, radiance_w_cm2_sr=5.6e2)
    assert stray_light.imaged_e_s(printed_sun, etendue) == pytest.approx(9.5e14, rel=0.01)
    assert stray_light.imaged_e_s(stray_light.EARTH, etendue) == pytest.approx(2.0e10, rel=0.08)
    sun, earth = (402, 154, 104, 71.2, 39.7), (119, 45.7, 31, 21, 11.8)
    for (_, area), sun_e_s, earth_e_s in zip(stray_light.PRINTED_AREA_CM2, sun, earth, strict=True):
        assert stray_light.stray_e_s(stray_light.SUN, area) == pytest.approx(sun_e_s, rel=6e-3)
        assert stray_light.stray_e_s(stray_light.EARTH, area) == pytest.approx(earth_e_s, rel=6e-3)
    assert stray_light.effective_area_cm2(np.radians(27.0)) == pytest.approx(6.69e-16)
    assert np.isnan(stray_light.effective_area_cm2(np.radians(15.0)))
