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


def test_every_field_of_an_orbit_is_inside_the_envelope():
    """The path of a zenith camera covers one revolution in equal steps, and all of its fields are inside the envelope."""
    band = BandEnvelope(
        SHAPE, AttitudeLimits("zenith", deg(-2, 2), deg(-2, 2), deg(0, 0)), from_elements(deg(97, 97), deg(30, 30))
    )
    path = sweep(band, SHAPE)
    assert path.over == "orbit"
    assert path.fields.shape == (STEPS, 17, 3)
    assert band.contains(path.fields.reshape(-1, 3)).all()
    steps_deg = np.degrees(np.arccos(np.einsum("ni,ni->n", path.boresights, np.roll(path.boresights, -1, 0))))
    assert steps_deg == pytest.approx(np.full(STEPS, 360 / STEPS), abs=1e-6)


def test_the_path_of_an_anti_sun_camera_covers_the_validity():
    """The path of an anti-Sun camera covers the whole validity. An inertially fixed camera has one field, and the whole
    sky has none.
    """
    patch = PatchEnvelope(SHAPE, AttitudeLimits("anti_sun", deg(-5, 5), deg(-5, 5)), deg(10, 40))
    path = sweep(patch, SHAPE)
    assert path.over == "validity"
    assert np.degrees(np.arccos(path.boresights[0] @ path.boresights[-1])) == pytest.approx(30, abs=0.1)
    inertial = sweep(PatchEnvelope(SHAPE, AttitudeLimits("inertial", ra_rad=1.0, dec_rad=0.2)), SHAPE)
    assert (inertial.over, len(inertial.fields)) == ("", 1)
    assert len(sweep(WholeSky(SHAPE), SHAPE).fields) == 0


def test_an_outline_is_closed_and_on_the_edge_of_the_field():
    """The first and last points are equal, and every point is on the edge of the field."""
    attitude = cam_from_icrs(1.2, -0.4, 0.7)
    (line,) = outlines(SHAPE, attitude[None])
    assert np.allclose(line[0], line[-1])
    cam = line @ attitude.T
    inner = cam * 0.999 + np.array([0.0, 0.0, 0.001])
    assert SHAPE.inside(inner / np.linalg.norm(inner, axis=1)[:, None]).all()
    assert not SHAPE.inside(cam + (cam - [0.0, 0.0, 1.0]) * 0.01).any()
