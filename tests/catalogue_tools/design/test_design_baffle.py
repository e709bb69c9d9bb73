"""Baffles: the printed example, and rays that must not get through."""

from __future__ import annotations

import numpy as np
import pytest

from gss.catalogue_tools.design import baffle as b
from gss.domain.errors import BadInput


def test_jacobs_baffle_is_the_printed_one() -> None:
    """Eq. 7.24 to 7.26: x 7.3 mm, front radius 18.3 and with 10 mm 21 mm, nothing from 28.1° on reaches the lens."""
    x = b.field_growth_mm(60, np.radians(7))
    assert x == pytest.approx(7.3, abs=0.1)
    assert 11 + x == pytest.approx(18.3, abs=0.1)
    made = b.one_stage_of_length(11, np.radians(7), 60, 10 - x)
    assert made.front_radius_mm == pytest.approx(21)
    assert np.degrees(made.exclusion_rad) == pytest.approx(28.1, abs=0.05)


def test_length_and_angle_are_each_others_inverse() -> None:
    """The tube made for an angle keeps out exactly that angle."""
    for angle in (20, 28.1, 45):
        made = b.one_stage(9.0, np.radians(7), np.radians(angle), 2.0)
        assert np.degrees(made.exclusion_rad) == pytest.approx(angle)
        assert made.front_radius_mm == pytest.approx(9 + 2 + made.length_mm * np.tan(np.radians(7)))


def test_no_direct_ray_at_the_angle_reaches_the_lens() -> None:
    """Rays through every point of the front, at the angle and beyond, pass outside the lens; a degree inside some hit it."""
    made = b.one_stage(9.0, np.radians(7), np.radians(30), 0.0)
    front = np.linspace(-made.front_radius_mm, made.front_radius_mm, 2001)

    def hits(angle_deg: float) -> bool:
        at_lens = front + made.length_mm * np.tan(np.radians(angle_deg))
        return bool(np.any(np.abs(at_lens) <= made.lens_radius_mm))

    assert not any(hits(angle) for angle in (30.01, 35, 60))
    assert hits(29.0)


def test_lens_sees_no_wall_between_the_vanes() -> None:
    """From the far edge of the lens over each tip the line meets the wall not before the next vane; tips leave the field free."""
    made = b.one_stage(9.0, np.radians(7), np.radians(30))
    wall = made.wall_mm[0][2]
    z, r = np.array(made.edge_mm).T
    assert len(z) > 3
    assert z[-1] == pytest.approx(made.length_mm)
    meets = z * (wall + made.lens_radius_mm) / (r + made.lens_radius_mm)
    assert np.all(meets[:-1] >= z[1:] - 1e-9)
    assert np.all(r >= made.lens_radius_mm + z * np.tan(np.radians(7)) - 1e-9)


def test_two_stages_keep_light_off_the_inner_front_and_edges_out_of_sight() -> None:
    """Moniteq §5.2's two rules for the 85 mm f/1.4 lens and 20°, and no shade of another inner length is shorter."""
    lens, field, sun = 85 / 2.8, float(np.radians(2.44)), float(np.radians(20))
    made = b.two_stage(lens, field, sun)
    inner = made.wall_mm[0][1]
    r1 = lens + inner * np.tan(field)
    outer = made.length_mm - inner
    assert outer * np.tan(sun) >= r1 + made.front_radius_mm - 1e-6
    sight = -lens + made.length_mm * (lens + r1) / inner
    assert made.front_radius_mm >= sight - 1e-6
    phi, theta = np.tan(field), np.tan(sun)
    others = np.geomspace(2 * lens / (theta - phi) * 1.001, 4000, 4000)
    lengths = others + 2 * (lens + others * phi) / (theta - phi - 2 * lens / others)
    assert made.length_mm == pytest.approx(lengths.min(), rel=1e-4)
    assert made.length_mm > b.one_stage(lens, field, sun).length_mm


def test_impossible_baffles_are_rejected() -> None:
    """A source inside the field, a lens without radius, a tube without length: each error states the expected value."""
    with pytest.raises(BadInput, match="corner of the field"):
        b.one_stage(9.0, np.radians(30), np.radians(20))
    with pytest.raises(BadInput, match="radius of the lens is out of range"):
        b.two_stage(0.0, 0.1, 0.5)
    with pytest.raises(BadInput, match="length of the baffle is out of range"):
        b.one_stage_of_length(9.0, 0.1, 0.0)
    with pytest.raises(BadInput, match="baffle would be too long"):
        b.two_stage(30.0, np.radians(10.0), np.radians(10.2))
