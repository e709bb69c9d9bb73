"""Path of the field of view through the envelope."""

import numpy as np
import pytest

from gss.catalogue_tools.envelope.attitude import AttitudeLimits
from gss.catalogue_tools.envelope.envelope import BandEnvelope, PatchEnvelope, WholeSky
from gss.catalogue_tools.envelope.field import FieldShape
from gss.catalogue_tools.envelope.orbits import from_elements
from gss.catalogue_tools.envelope.sweep import STEPS, outlines, sweep
from gss.domain.frames import cam_from_icrs
from gss.instruments.registry import shipped_camera

SHAPE = FieldShape(shipped_camera("cubestar").camera)


def deg(*values):
    return tuple(float(np.radians(v)) for v in values)


def test_every_field_of_an_orbit_lies_inside_the_envelope():
    """A zenith camera completes one revolution; everything that it sees lies inside the envelope."""
    band = BandEnvelope(
        SHAPE, AttitudeLimits("zenith", deg(-2, 2), deg(-2, 2), deg(0, 0)), from_elements(deg(97, 97), deg(30, 30))
    )
    way = sweep(band, SHAPE)
    assert way.over == "orbit"
    assert way.fields.shape == (STEPS, 17, 3)
    assert band.contains(way.fields.reshape(-1, 3)).all()
    steps_deg = np.degrees(np.arccos(np.einsum("ni,ni->n", way.boresights, np.roll(way.boresights, -1, 0))))
    assert steps_deg == pytest.approx(np.full(STEPS, 360 / STEPS), abs=1e-6)


def test_a_camera_away_from_the_sun_follows_it_from_the_first_to_the_last_day():
    """The path covers both ends of the validity; an inertially fixed camera has one field, the whole sky has none."""
    patch = PatchEnvelope(SHAPE, AttitudeLimits("anti_sun", deg(-5, 5), deg(-5, 5)), deg(10, 40))
    way = sweep(patch, SHAPE)
    assert way.over == "validity"
    assert np.degrees(np.arccos(way.boresights[0] @ way.boresights[-1])) == pytest.approx(30, abs=0.1)
    fixed = sweep(PatchEnvelope(SHAPE, AttitudeLimits("inertial", ra_rad=1.0, dec_rad=0.2)), SHAPE)
    assert (fixed.over, len(fixed.fields)) == ("", 1)
    assert len(sweep(WholeSky(SHAPE), SHAPE).fields) == 0


def test_an_outline_is_closed_and_surrounds_the_boresight():
    """First and last point are one, and every point is on the edge of what the field shows."""
    attitude = cam_from_icrs(1.2, -0.4, 0.7)
    (line,) = outlines(SHAPE, attitude[None])
    assert np.allclose(line[0], line[-1])
    cam = line @ attitude.T
    inner = cam * 0.999 + np.array([0.0, 0.0, 0.001])
    assert SHAPE.inside(inner / np.linalg.norm(inner, axis=1)[:, None]).all()
    assert not SHAPE.inside(cam + (cam - [0.0, 0.0, 1.0]) * 0.01).any()
