"""Defects of a simulated detector: determined by the seed, with the requested amounts."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gss.domain.camera import Camera
from gss.domain.errors import BadInput
from gss.domain.sensor import NO_DEFECTS, Defects
from gss.instruments.registry import shipped_camera, shipped_registry
from gss.pipeline.chip import make_chip
from gss.pipeline.readout import FixedPattern, expose

CAMERA = Camera.from_fov(300, 200, 0.3)
SENSOR = replace(shipped_camera("cubestar").sensor, gain_e_per_dn=1.0, bits=16, full_well_e=60_000.0, bias_dn=500.0)
DEFECTS = Defects(0.02, 3.0, 5.0, 0.5, 1e-3, 4000.0, 5e-4, 0.3)


def _flat(level_e: float, exposure_s: float = 0.25, **options: object) -> np.ndarray:
    """Expose a uniformly lit frame and return it as floating-point numbers."""
    light = np.full((CAMERA.rows, CAMERA.columns), level_e)
    return expose(light, SENSOR, exposure_s, np.random.default_rng(1), **options).astype(float)  # type: ignore[arg-type]


def test_the_seed_determines_the_chip() -> None:
    """The same seed gives the same hot and dead pixels and the same pattern. Another seed gives different ones."""
    first, same, other = (make_chip(DEFECTS, SENSOR, CAMERA, seed) for seed in (4, 4, 5))
    for name in ("response", "dark_e_s", "offset_dn", "hot", "dead"):
        assert np.array_equal(getattr(first, name), getattr(same, name))
        assert not np.array_equal(getattr(first, name), getattr(other, name))


def test_defects_have_the_requested_amounts() -> None:
    """The numbers of hot and dead pixels, the spreads of response and offsets, and the loss at the corners are as
    requested.
    """
    chip = make_chip(DEFECTS, SENSOR, CAMERA, 7)
    assert (len(chip.hot), len(chip.dead)) == (60, 30)
    assert not set(chip.hot.tolist()) & set(chip.dead.tolist())
    assert (chip.response.ravel()[chip.dead] == 0).all()
    middle = chip.response[90:110, 100:200]
    assert middle[middle > 0].std() == pytest.approx(0.02, rel=0.1)
    columns = chip.offset_dn.mean(axis=0)
    assert columns.std() == pytest.approx(5.0, rel=0.15)
    assert (chip.offset_dn - columns).std() == pytest.approx(3.0, rel=0.05)
    corner = chip.response[:12, :12]
    assert corner[corner > 0].mean() == pytest.approx(0.7, abs=0.03)


def test_the_pattern_is_constant_and_the_noise_varies() -> None:
    """The mean of many frames agrees with the noiseless pattern. The dark factor multiplies the dark current, and dead
    pixels receive no light.
    """
    chip = make_chip(DEFECTS, SENSOR, CAMERA, 7)
    noiseless = _flat(200.0, noise=False, chip=chip)
    rng = np.random.default_rng(2)
    light = np.full((CAMERA.rows, CAMERA.columns), 200.0)
    mean = np.mean([expose(light, SENSOR, 0.25, rng, chip=chip) for _ in range(40)], axis=0)
    assert np.abs(mean - noiseless).mean() < 3.0
    dark, doubled = (_flat(0.0, noise=False, chip=chip, dark_factor=f).ravel()[chip.hot].mean() for f in (1.0, 2.0))
    assert dark > 500 + 600
    assert doubled - 500 == pytest.approx(2 * (dark - 500), rel=0.02)
    assert _flat(5000.0, noise=False, chip=chip).ravel()[chip.dead].max() < 600


def test_a_perfect_chip_has_the_expected_signal() -> None:
    """A chip without defects gives the same frame as no chip, also with a veil of zero and a fixed pattern."""
    perfect = make_chip(NO_DEFECTS, SENSOR, CAMERA, 3)
    assert np.array_equal(_flat(300.0, noise=False, chip=perfect), _flat(300.0, noise=False))
    veil = np.zeros((CAMERA.rows, CAMERA.columns), np.float32)
    pattern = FixedPattern(5)
    with_veil = _flat(300.0, noise=False, veil_e_s=veil, fixed_pattern=pattern)
    assert np.array_equal(with_veil, _flat(300.0, noise=False, fixed_pattern=pattern))


def test_a_veil_adds_shot_noise() -> None:
    """A veil of N electrons adds √N of shot noise."""
    veil = np.full((CAMERA.rows, CAMERA.columns), 16_000.0, np.float32)
    frame = _flat(0.0, veil_e_s=veil)
    uniform_e = (SENSOR.dark_current_e_s + SENSOR.background_e_s) * 0.25
    assert frame.mean() == pytest.approx(500 + 4000 + uniform_e, rel=0.002)
    assert frame.std() == pytest.approx(np.sqrt(4000 + uniform_e + SENSOR.read_noise_e**2), rel=0.02)


@pytest.mark.parametrize("defects", [Defects(hot_share=0.6, dead_share=0.6), Defects(-0.1), Defects(corner_loss=1.0)])
def test_invalid_defects_are_rejected(defects: Defects) -> None:
    """More defective pixels than pixels, negative spreads and black corners are rejected."""
    with pytest.raises(BadInput, match="invalid detector defects"):
        make_chip(defects, SENSOR, CAMERA, 1)


def test_every_profile_states_the_source_of_its_defects_and_baffle() -> None:
    """Each camera has defects and a baffle, and states their source or that they were chosen."""
    for p in (i.profile for i in shipped_registry().all() if i.profile.chain):
        assert p.defects != NO_DEFECTS
        assert {"defects", "sun, earth", "blind"} <= set(p.sources)
        assert p.camera.half_diagonal_rad < p.baffle.blind_rad <= p.baffle.sun_limit_rad
