"""Dark columns and drift of the video level in the read-out model."""

from dataclasses import replace

import numpy as np
import pytest

from gss.domain.dark_columns import NO_DARK_COLUMNS
from gss.instruments.registry import shipped_camera
from gss.pipeline.readout import drift_dn, expose

SUNSAT = shipped_camera("sunsat")


def test_dark_columns_see_no_light() -> None:
    """Dark pixels have dark current and read-out noise only; the light-sensitive pixels do not depend on them."""
    light_e, sensor = np.full((582, 752), 1500.0), SUNSAT.sensor
    assert (sensor.dark_columns.left, sensor.dark_columns.right) == (3, 40)
    picture, plain = (
        expose(light_e, sensor, 0.5, np.random.default_rng(1), dark_columns=columns)
        for columns in (sensor.dark_columns, NO_DARK_COLUMNS)
    )
    assert picture.shape == (582, 795)
    pixels, dark = sensor.dark_columns.split(picture, 752)
    assert dark is not None
    assert (pixels == plain).all()
    level_e = sensor.dark_current_e_s * 0.5
    assert float(dark.mean()) == pytest.approx(sensor.bias_dn + level_e / sensor.gain_e_per_dn, abs=0.05)
    noise_dn = np.sqrt(level_e + sensor.read_noise_e**2 + sensor.gain_e_per_dn**2 / 12) / sensor.gain_e_per_dn
    assert float(dark.std()) == pytest.approx(noise_dn, rel=0.05)


def test_drift_is_that_of_the_document() -> None:
    """After 909 pixels at full scale the level has fallen by one of 64 levels (Jacobs 1995 eq. 8.2, 8.3), and in a constant
    image it falls exponentially, in the odd field first."""
    assert drift_dn(np.array([64.0, 64.0, 64.0]), 909, 57800.0)[2] == pytest.approx(-1.0, abs=0.01)
    rows, light_dn, row_px = 582, 10.0, 795
    drift = drift_dn(np.full(rows, light_dn), row_px, 57800.0)
    order = np.concatenate([np.arange(0, rows, 2), np.arange(1, rows, 2)])
    expected = -light_dn * (1 - np.exp(-np.arange(rows) * row_px / 57800.0))
    assert drift[order] == pytest.approx(expected, abs=1e-4)


def test_an_image_without_light_does_not_drift() -> None:
    """Dark current is in the dark rows too, so it does not change the level of the amplifier."""
    sensor = replace(SUNSAT.sensor, background_e_s=0.0)
    picture = expose(
        np.zeros((582, 752)),
        sensor,
        0.5,
        np.random.default_rng(4),
        dark_columns=sensor.dark_columns,
        coupling_px=57800.0,
    )
    assert abs(float(picture[:50].mean() - picture[-50:].mean())) < 0.03
