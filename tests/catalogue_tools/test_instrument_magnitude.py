"""Instrument magnitudes: Planck's law and integrals compared with astropy, lens losses with a sum over pixels."""

from __future__ import annotations

from dataclasses import replace

import astropy.units as u
import numpy as np
import pytest
from astropy.modeling.physical_models import BlackBody
from hypothesis import given
from hypothesis import strategies as st

from gss.catalogue_tools.corrections.correction_switches import Corrections
from gss.catalogue_tools.corrections.instrument_magnitude import (
    V_PASSBAND,
    V_WAVELENGTH_NM,
    instrument_minus_v,
    roll_off_mag,
    temperature_k,
)
from gss.catalogue_tools.corrections.sky_source import corrected
from gss.catalogue_tools.sources.gaia import v_from_g
from gss.catalogue_tools.sources.hipparcos import load_stars
from gss.domain.errors import BadInput
from gss.domain.response import GENERIC, RESPONSES, SpectralResponse, response_of
from gss.domain.sensor import Defects
from gss.instruments.registry import shipped_camera, shipped_registry

ASTROPY_TOLERANCE_MAG = 0.002


def test_temperature_of_the_sun() -> None:
    """A star with B−V = 0.65 has the temperature of the Sun, 5 770 K. Bluer stars are hotter."""
    assert temperature_k(0.65) == pytest.approx(5778, abs=30)
    assert np.all(np.diff(temperature_k(np.linspace(-0.4, 2.5, 50))) < 0)


@pytest.mark.parametrize("name", sorted(RESPONSES))
def test_integrals_agree_with_astropy(name: str) -> None:
    """For each camera, the magnitudes of five colours agree with those of astropy's blackbody, integrated in steps of
    0.1 nm.
    """
    response = RESPONSES[name]
    fine = np.arange(300.0, 1200.0, 0.1)

    def ratio(kelvin: float) -> float:
        light = BlackBody(kelvin * u.K, scale=1 * u.erg / u.s / u.cm**2 / u.AA / u.sr)(fine * u.nm).value
        v_band = np.interp(fine, V_WAVELENGTH_NM, V_PASSBAND, left=0, right=0)
        return float((light * response.at(fine)).sum() / (light * v_band).sum())

    colours = np.array([-0.3, 0.3, 0.65, 1.2, 1.9])
    expected = [-2.5 * np.log10(ratio(float(temperature_k(c))) / ratio(float(temperature_k(0.0)))) for c in colours]
    assert np.abs(instrument_minus_v(colours, response, 0.6) - expected).max() < ASTROPY_TOLERANCE_MAG


def test_blackbodies_agree_with_gaia_colours() -> None:
    """In Gaia's G band, known to a few per cent, V − G of blackbodies agrees within 0.05 mag with that measured for 92
    883 stars.
    """
    nm = (330, 350, 400, 450, 500, 550, 600, 650, 700, 750, 800, 850, 900, 950, 1000, 1050)
    photons = (0, 0.1, 0.45, 0.58, 0.64, 0.67, 0.69, 0.70, 0.69, 0.65, 0.58, 0.49, 0.37, 0.22, 0.1, 0)
    g_band = SpectralResponse(
        "G", "approximate", tuple(map(float, nm)), tuple(a * b for a, b in zip(nm, photons, strict=True))
    )
    colours = np.array([-0.2, 0.0, 0.3, 0.65, 1.0, 1.5])
    measured = v_from_g(np.zeros(6), colours) - v_from_g(np.zeros(1), np.zeros(1))
    assert np.abs(-instrument_minus_v(colours, g_band, 0.6) - measured).max() < 0.05


def test_a_camera_with_the_v_band_gives_v() -> None:
    """With the response of Johnson's V, the instrument magnitude equals V."""
    v_band = SpectralResponse("V", "Bessell 1990", tuple(V_WAVELENGTH_NM), V_PASSBAND)
    assert np.abs(instrument_minus_v(np.linspace(-0.4, 2.5, 30), v_band, 0.6)).max() < 1e-12


@given(b_v=st.floats(-0.3, 2.4))
def test_red_stars_are_brighter_for_silicon(b_v: float) -> None:
    """For a sensor that is more sensitive to red than V, the redder of two stars of equal V is always brighter."""
    pair = instrument_minus_v(np.array([b_v, b_v + 0.1]), RESPONSES["oersted"], 0.6)
    assert pair[1] < pair[0]


def test_white_stars_have_no_correction() -> None:
    """Stars with B−V = 0 have the instrument magnitude V. A star without a colour is treated as one with the stated
    default colour.
    """
    for response in (*RESPONSES.values(), GENERIC):
        shift = instrument_minus_v(np.array([0.0, np.nan, 0.6]), response, 0.6)
        assert shift[0] == pytest.approx(0, abs=1e-6)
        assert shift[1] == shift[2]


def test_every_profile_has_a_response_with_its_source() -> None:
    """Every camera has a response curve and states which part of it was chosen. Other profiles have the generic curve."""
    for profile in (i.profile for i in shipped_registry().all() if i.profile.chain):
        assert "chosen" in response_of(profile).source
    assert response_of(replace(shipped_camera("sunsat"), name="mine")) is GENERIC
    aim = RESPONSES["aim"]
    assert aim.at(np.linspace(400, 1000, 601)).mean() == pytest.approx(0.15, rel=0.01)
    assert max(RESPONSES["far_mst"].a_per_w) == pytest.approx(0.16)


@pytest.mark.parametrize("name", sorted(i.name for i in shipped_registry().all() if i.profile.chain))
def test_mean_lens_loss_agrees_with_the_pixels(name: str) -> None:
    """The average roll-off is the mean over all pixels of a loss that grows with the square of the radius."""
    profile = shipped_camera(name)
    camera = profile.camera
    col = np.arange(camera.columns) - camera.centre_col_px
    row = np.arange(camera.rows) - camera.centre_row_px
    corner = max(np.hypot(c, r) for c in col[[0, -1]] for r in row[[0, -1]])
    loss = profile.defects.corner_loss * (np.add.outer(row**2, col**2) / corner**2).mean()
    assert roll_off_mag(profile, "average") == pytest.approx(-2.5 * np.log10(1 - loss), rel=0.01)
    assert roll_off_mag(profile, "worst") == pytest.approx(-2.5 * np.log10(1 - profile.defects.corner_loss))
    assert roll_off_mag(profile, "off") == 0


def test_corrections_record_the_source_of_colours() -> None:
    """The recorded facts state the source of the response curve and the number of stars without colour."""
    sky = corrected(load_stars(), Corrections(instrument_magnitude=True), 2026.9, profile=shipped_camera("oersted"))
    fact = sky.facts["applied"][-1]
    assert (fact["name"], fact["no_colour"]) == ("instrument_magnitude", 52)
    assert fact["source"].startswith("chosen")
    assert 0.5 < fact["largest"] < 1.6


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: SpectralResponse("x", "", (400.0,), (1.0,)), "response curve"),
        (lambda: SpectralResponse("x", "", (500.0, 400.0), (1.0, 1.0)), "response curve"),
        (lambda: SpectralResponse("x", "", (400.0, 500.0), (0.0, 0.0)), "response curve"),
        (lambda: SpectralResponse("x", "", (400.0, 500.0), (-1.0, 1.0)), "response curve"),
        (lambda: roll_off_mag(shipped_camera("aim"), "much"), "roll-off"),
        (lambda: roll_off_mag(replace(shipped_camera("aim"), defects=Defects(corner_loss=1.0)), "worst"), "no light"),
    ],
)
def test_invalid_optics_are_rejected(make, message) -> None:  # type: ignore[no-untyped-def]
    """Invalid response curves and roll-offs are rejected, and the error names the field."""
    with pytest.raises(BadInput, match=message):
        make()
