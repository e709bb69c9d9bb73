"""Light sources that are not catalogue stars, veils and trails: how they are rendered, what the truth contains, and the
maximum length of trails.
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
NO_STARS = STARS.take(np.zeros(0, np.intp))
RATE = np.array([0.0, 0.05, 0.0])


def _dark() -> float:
    """Return the level of a dark pixel in digital numbers."""
    return SENSOR.bias_dn + (SENSOR.dark_current_e_s + SENSOR.background_e_s) * 0.2


def test_a_light_is_rendered_like_a_star() -> None:
    """A light gives the same image as a star of its magnitude, with and without rotation, but is not in the truth."""
    one_star = STARS.take(np.array([100]))
    east = np.cross([0.0, 0.0, 1.0], one_star.icrs[0])
    east /= np.linalg.norm(east)
    attitude = np.stack([east, np.cross(one_star.icrs[0], east), one_star.icrs[0]])
    light = Lights(one_star.icrs, one_star.v_mag)
    for rate in (np.zeros(3), RATE):
        rng = np.random.default_rng(0)
        star = render(one_star, CAMERA, SENSOR, attitude, 0.2, rng, rate_rad_s=rate, noise=False)
        other = render(NO_STARS, CAMERA, SENSOR, attitude, 0.2, rng, rate_rad_s=rate, noise=False, lights=light)
        assert np.array_equal(star.pixels, other.pixels)
        assert len(star.truth.hip) == 1
        assert len(other.truth.hip) == 0


def test_a_veil_adds_light_and_blocks_stars() -> None:
    """A veil adds its electrons per second times the exposure. Blocked pixels show no stars."""
    one_star = STARS.take(np.array([100]))
    east = np.cross([0.0, 0.0, 1.0], one_star.icrs[0])
    east /= np.linalg.norm(east)
    attitude = np.stack([east, np.cross(one_star.icrs[0], east), one_star.icrs[0]])
    blocked = np.zeros((300, 400), bool)
    blocked[:, :200] = True
    veil = Veil(np.where(blocked, np.float32(1000), np.float32(100)), blocked)
    frame = render(one_star, CAMERA, SENSOR, attitude, 0.2, np.random.default_rng(0), noise=False, veil=veil).pixels
    assert frame[10, 10] == pytest.approx(_dark() + 200, abs=1)
    assert frame[10, 390] == pytest.approx(_dark() + 20, abs=1)
    assert (frame[:, :200] == frame[10, 10]).all()
    assert frame[:, 200:].max() > frame[10, 390] + 50


def test_the_longest_trail_is_rendered_and_a_longer_one_rejected() -> None:
    """``longest_trail_s`` returns the renderer's limit. A camera without rotation has no limit."""
    longest_s = longest_trail_s(CAMERA, SENSOR, RATE)
    rng = np.random.default_rng(0)
    render(STARS, CAMERA, SENSOR, np.eye(3), 0.999 * longest_s, rng, rate_rad_s=RATE)
    with pytest.raises(BadInput, match="too fast"):
        render(STARS, CAMERA, SENSOR, np.eye(3), 1.05 * longest_s, rng, rate_rad_s=RATE)
    assert longest_trail_s(CAMERA, SENSOR, np.zeros(3)) == np.inf
