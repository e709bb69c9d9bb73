"""Light sources that are not catalogue stars, and trails: rendered like stars, not in the truth, up to the maximum
length.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gss.catalogue_tools.sources.hipparcos import load_stars
from gss.domain.camera import Camera
from gss.domain.errors import BadInput
from gss.instruments.registry import shipped_camera
from gss.pipeline.render import Lights, longest_trail_s, render
from gss.pipeline.veil import Veil

CAMERA = Camera.from_fov(400, 300, 0.2)
SENSOR = replace(shipped_camera("cubestar").sensor, bits=16, gain_e_per_dn=1.0, full_well_e=65_000.0)
STARS = load_stars(5.0)
NONE = STARS.take(np.zeros(0, np.intp))
RATE = np.array([0.0, 0.05, 0.0])


def _dark() -> float:
    return SENSOR.bias_dn + (SENSOR.dark_current_e_s + SENSOR.background_e_s) * 0.2


def test_a_light_is_drawn_as_a_star_of_its_magnitude_and_moves_with_the_sky() -> None:
    """The same picture, still and in a trail, but no truth of it."""
    one = STARS.take(np.array([100]))
    east = np.cross([0.0, 0.0, 1.0], one.icrs[0])
    east /= np.linalg.norm(east)
    attitude = np.stack([east, np.cross(one.icrs[0], east), one.icrs[0]])
    light = Lights(one.icrs, one.v_mag)
    for rate in (np.zeros(3), RATE):
        rng = np.random.default_rng(0)
        star = render(one, CAMERA, SENSOR, attitude, 0.2, rng, rate_rad_s=rate, noise=False)
        other = render(NONE, CAMERA, SENSOR, attitude, 0.2, rng, rate_rad_s=rate, noise=False, lights=light)
        assert np.array_equal(star.pixels, other.pixels)
        assert len(star.truth.hip) == 1
        assert len(other.truth.hip) == 0


def test_a_veil_adds_its_light_and_hides_what_is_behind_it() -> None:
    """Electrons per second times the exposure; blocked pixels have no stars."""
    one = STARS.take(np.array([100]))
    east = np.cross([0.0, 0.0, 1.0], one.icrs[0])
    east /= np.linalg.norm(east)
    attitude = np.stack([east, np.cross(one.icrs[0], east), one.icrs[0]])
    blocked = np.zeros((300, 400), bool)
    blocked[:, :200] = True
    veil = Veil(np.where(blocked, np.float32(1000), np.float32(100)), blocked)
    frame = render(one, CAMERA, SENSOR, attitude, 0.2, np.random.default_rng(0), noise=False, veil=veil).pixels
    assert frame[10, 10] == pytest.approx(_dark() + 200, abs=1)
    assert frame[10, 390] == pytest.approx(_dark() + 20, abs=1)
    assert (frame[:, :200] == frame[10, 10]).all()
    assert frame[:, 200:].max() > frame[10, 390] + 50


def test_the_longest_trail_is_rendered_and_a_longer_one_rejected() -> None:
    """The limit that the function returns is the renderer's limit."""
    longest_s = longest_trail_s(CAMERA, SENSOR, RATE)
    rng = np.random.default_rng(0)
    render(STARS, CAMERA, SENSOR, np.eye(3), 0.999 * longest_s, rng, rate_rad_s=RATE)
    with pytest.raises(BadInput, match="too fast"):
        render(STARS, CAMERA, SENSOR, np.eye(3), 1.05 * longest_s, rng, rate_rad_s=RATE)
    assert longest_trail_s(CAMERA, SENSOR, np.zeros(3)) == np.inf
