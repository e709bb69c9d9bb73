"""Baffles: the example of Jacobs, and the geometry of rays and vanes."""

from __future__ import annotations

import numpy as np
import pytest

from gss.catalogue_tools.design import baffle as baffles
from gss.domain.errors import BadInput


def test_baffle_of_jacobs_is_reproduced() -> None:
    """Eq. 7.24 to 7.26 give x = 7.3 mm and a front radius of 18.3 mm or, for a shade of 10 mm, 21 mm. No light from
    28.1° or more reaches the lens.
    """
    x = baffles.field_growth_mm(60, np.radians(7))
    assert x == pytest.approx(7.3, abs=0.1)
    assert 11 + x == pytest.approx(18.3, abs=0.1)
    baffle = baffles.one_stage_of_length(11, np.radians(7), 60, 10 - x)
    assert baffle.front_radius_mm == pytest.approx(21)
    assert np.degrees(baffle.exclusion_rad) == pytest.approx(28.1, abs=0.05)


def test_length_and_angle_are_inverse_functions() -> None:
    """The tube calculated for an angle excludes light from exactly that angle."""
    for angle in (20, 28.1, 45):
        baffle = baffles.one_stage(9.0, np.radians(7), np.radians(angle), 2.0)
        assert np.degrees(baffle.exclusion_rad) == pytest.approx(angle)
        assert baffle.front_radius_mm == pytest.approx(9 + 2 + baffle.length_mm * np.tan(np.radians(7)))


def test_no_direct_ray_at_the_angle_reaches_the_lens() -> None:
    """Rays through the front at the exclusion angle or beyond miss the lens. One degree inside the angle, some rays hit
    it.
    """
    baffle = baffles.one_stage(9.0, np.radians(7), np.radians(30), 0.0)
    front = np.linspace(-baffle.front_radius_mm, baffle.front_radius_mm, 2001)

    def hits(angle_deg: float) -> bool:
        at_lens = front + baffle.length_mm * np.tan(np.radians(angle_deg))
        return bool(np.any(np.abs(at_lens) <= baffle.lens_radius_mm))

    assert not any(hits(angle) for angle in (30.01, 35, 60))
    assert hits(29.0)


def test_lens_sees_no_wall_between_the_vanes() -> None:
    """A line from the far edge of the lens past each vane meets the wall at or behind the next vane. Vanes do not
    obstruct the field.
    """
    baffle = baffles.one_stage(9.0, np.radians(7), np.radians(30))
    wall = baffle.wall_mm[0][2]
    z, r = np.array(baffle.edge_mm).T
    assert len(z) > 3
    assert z[-1] == pytest.approx(baffle.length_mm)
    meets = z * (wall + baffle.lens_radius_mm) / (r + baffle.lens_radius_mm)
    assert np.all(meets[:-1] >= z[1:] - 1e-9)
    assert np.all(r >= baffle.lens_radius_mm + z * np.tan(np.radians(7)) - 1e-9)


def test_two_stages_satisfy_the_rules_of_moniteq() -> None:
    """The two-stage baffle for the 85 mm f/1.4 lens and 20° satisfies both rules of Moniteq §5.2, and no other inner
    length gives a shorter one.
    """
    lens, field, sun = 85 / 2.8, float(np.radians(2.44)), float(np.radians(20))
    baffle = baffles.two_stage(lens, field, sun)
    inner = baffle.wall_mm[0][1]
    r1 = lens + inner * np.tan(field)
    outer = baffle.length_mm - inner
    assert outer * np.tan(sun) >= r1 + baffle.front_radius_mm - 1e-6
    line_of_sight_mm = -lens + baffle.length_mm * (lens + r1) / inner
    assert baffle.front_radius_mm >= line_of_sight_mm - 1e-6
    phi, theta = np.tan(field), np.tan(sun)
    inner_lengths = np.geomspace(2 * lens / (theta - phi) * 1.001, 4000, 4000)
    lengths = inner_lengths + 2 * (lens + inner_lengths * phi) / (theta - phi - 2 * lens / inner_lengths)
    assert baffle.length_mm == pytest.approx(lengths.min(), rel=1e-4)
    assert baffle.length_mm > baffles.one_stage(lens, field, sun).length_mm


def test_invalid_baffles_are_rejected() -> None:
    """A source inside the field, a lens without radius, a tube without length and an excessive length are rejected."""
    with pytest.raises(BadInput, match="corner of the field"):
        baffles.one_stage(9.0, np.radians(30), np.radians(20))
    with pytest.raises(BadInput, match="radius of the lens is out of range"):
        baffles.two_stage(0.0, 0.1, 0.5)
    with pytest.raises(BadInput, match="length of the baffle is out of range"):
        baffles.one_stage_of_length(9.0, 0.1, 0.0)
    with pytest.raises(BadInput, match="baffle would be too long"):
        baffles.two_stage(30.0, np.radians(10.0), np.radians(10.2))
