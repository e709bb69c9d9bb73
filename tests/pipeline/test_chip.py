"""A detector's defects: determined by the seed, with the requested positions and amounts."""

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
FLAWS = Defects(0.02, 3.0, 5.0, 0.5, 1e-3, 4000.0, 5e-4, 0.3)


def _flat(level_e: float, exposure_s: float = 0.25, **options: object) -> np.ndarray:
    light = np.full((CAMERA.rows, CAMERA.columns), level_e)
    return expose(light, SENSOR, exposure_s, np.random.default_rng(1), **options).astype(float)  # type: ignore[arg-type]


def test_a_seed_is_a_chip() -> None:
    """The same seed has the same hot and dead pixels and the same pattern; another seed has others."""
    one, same, other = (make_chip(FLAWS, SENSOR, CAMERA, seed) for seed in (4, 4, 5))
    for name in ("response", "dark_e_s", "offset_dn", "hot", "dead"):
        assert np.array_equal(getattr(one, name), getattr(same, name))
        assert not np.array_equal(getattr(one, name), getattr(other, name))


def test_defects_have_the_requested_amounts() -> None:
    """Shares of hot and dead pixels, spreads of response and offsets, the corner's loss."""
    chip = make_chip(FLAWS, SENSOR, CAMERA, 7)
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


def test_the_pattern_stays_while_the_noise_changes() -> None:
    """The mean of many frames shows columns, hot and dead pixels; dark current, not light, doubles with the factor."""
    chip = make_chip(FLAWS, SENSOR, CAMERA, 7)
    quiet = _flat(200.0, noise=False, chip=chip)
    rng = np.random.default_rng(2)
    light = np.full((CAMERA.rows, CAMERA.columns), 200.0)
    mean = np.mean([expose(light, SENSOR, 0.25, rng, chip=chip) for _ in range(40)], axis=0)
    assert np.abs(mean - quiet).mean() < 3.0
    dark, twice = (_flat(0.0, noise=False, chip=chip, dark_factor=f).ravel()[chip.hot].mean() for f in (1.0, 2.0))
    assert dark > 500 + 600
    assert twice - 500 == pytest.approx(2 * (dark - 500), rel=0.02)
    assert _flat(5000.0, noise=False, chip=chip).ravel()[chip.dead].max() < 600


def test_a_perfect_chip_has_the_expected_signal() -> None:
    """Without flaws the general path and the plain one agree, with a fixed pattern too."""
    perfect = make_chip(NO_DEFECTS, SENSOR, CAMERA, 3)
    assert np.array_equal(_flat(300.0, noise=False, chip=perfect), _flat(300.0, noise=False))
    veil = np.zeros((CAMERA.rows, CAMERA.columns), np.float32)
    pattern = FixedPattern(5)
    with_veil = _flat(300.0, noise=False, veil_e_s=veil, fixed_pattern=pattern)
    assert np.array_equal(with_veil, _flat(300.0, noise=False, fixed_pattern=pattern))


def test_noise_is_that_of_the_light_of_each_pixel() -> None:
    """A veil of N electrons adds √N of noise, as shot noise does."""
    veil = np.full((CAMERA.rows, CAMERA.columns), 16_000.0, np.float32)
    frame = _flat(0.0, veil_e_s=veil)
    even_e = (SENSOR.dark_current_e_s + SENSOR.background_e_s) * 0.25
    assert frame.mean() == pytest.approx(500 + 4000 + even_e, rel=0.002)
    assert frame.std() == pytest.approx(np.sqrt(4000 + even_e + SENSOR.read_noise_e**2), rel=0.02)


@pytest.mark.parametrize("flaw", [Defects(hot_share=0.6, dead_share=0.6), Defects(-0.1), Defects(corner_loss=1.0)])
def test_impossible_flaws_are_refused(flaw: Defects) -> None:
    """More flawed pixels than pixels, negative spreads and black corners are bad input."""
    with pytest.raises(BadInput, match="invalid detector defects"):
        make_chip(flaw, SENSOR, CAMERA, 1)


def test_every_profile_has_flaws_and_a_baffle_with_a_source() -> None:
    """Each camera states its defects with a source, or that they were chosen."""
    for p in (i.profile for i in shipped_registry().all() if i.profile.chain):
        assert p.defects != NO_DEFECTS
        assert {"defects", "sun, earth", "blind"} <= set(p.sources)
        assert p.camera.half_diagonal_rad < p.baffle.blind_rad <= p.baffle.sun_limit_rad
