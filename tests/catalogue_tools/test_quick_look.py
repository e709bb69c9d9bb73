"""The preview's quick look, compared with the exact envelope; manifests of both versions; and requests restored from
them.
"""

import hashlib
import json
from dataclasses import replace
from datetime import UTC, datetime

import numpy as np
import pytest

from gss.catalogue_tools.build import build, preview
from gss.catalogue_tools.envelope.attitude import AttitudeLimits
from gss.catalogue_tools.envelope.healpix import centres
from gss.catalogue_tools.envelope.occultation import Occultation
from gss.catalogue_tools.manifest import SINCE_2, read_manifest
from gss.catalogue_tools.plan import plan
from gss.catalogue_tools.quick_look import QuickLook
from gss.catalogue_tools.request import BuildRequest, ElementsOrbit, TleOrbit, parameters_of, request_from
from gss.catalogue_tools.selection.selection import SelectionRules
from gss.catalogue_tools.sources.hipparcos import load_stars
from gss.domain.errors import CorruptData
from gss.instruments.registry import shipped_camera


def deg(*values):
    return tuple(float(np.radians(v)) for v in values)


BOX = deg(-5, 5)
REQUEST = BuildRequest(
    shipped_camera("sunsat"),
    "sunsat",
    SelectionRules(5.0),
    orbit=ElementsOrbit(deg(97, 97), deg(133, 149)),
    attitude=AttitudeLimits("sunsat", deg(-10, 10), deg(-5, 5), deg(130, 140)),
    start=datetime(2026, 12, 1, tzinfo=UTC),
    pointings=500,
)
LAWS = [AttitudeLimits(law, BOX, BOX, BOX, ra_rad=1.0) for law in ("zenith", "inertial", "anti_sun", "sun_pointing")]


@pytest.mark.parametrize("limits", LAWS, ids=lambda limits: limits.pointing)
def test_the_quick_look_has_the_same_stars_as_the_envelope(limits):
    """For each pointing law, the sampled membership equals the exact one, except for at most one star and 0.1 % of
    random directions.
    """
    planned = plan(replace(REQUEST, attitude=limits))
    stars = load_stars(6.0).icrs
    assert np.count_nonzero(QuickLook(planned).contains(stars) != planned.envelope.contains(stars)) <= 1
    rng = np.random.default_rng(5)
    directions = rng.normal(size=(4000, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    assert np.mean(QuickLook(planned).contains(directions) != planned.envelope.contains(directions)) < 1e-3


@pytest.mark.parametrize("law", ["zenith", "target", "sunsat"])
def test_the_quick_look_has_nearly_the_same_stars_with_occultation(law):
    """With occultation by Earth, Sun and Moon, the preview has at most two additional stars and misses less than 1 %.
    Time fractions agree with the exact ones within 0.006.
    """
    off_nadir = {"off_nadir_rad": deg(30)[0]} if law == "target" else {}
    limits = AttitudeLimits(law, BOX, BOX, BOX, **off_nadir)
    occultation = Occultation(700e3, *deg(20, 28.1, 28.1))
    planned = plan(replace(REQUEST, attitude=limits, occultation=occultation))
    stars, quick_look = load_stars(6.0).icrs, QuickLook(planned)
    sampled, exact = quick_look.contains(stars), planned.envelope.contains(stars)
    assert np.count_nonzero(sampled & ~exact) <= 2
    assert np.count_nonzero(exact & ~sampled) < 0.01 * np.count_nonzero(exact)
    grid = centres(quick_look.nside)
    assert np.abs(quick_look.time_fraction(grid) - planned.envelope.time_fraction(grid)).max() < 0.006


@pytest.mark.parametrize("law", ["anti_sun", "sun_pointing"])
def test_precomputed_fields_do_not_change_the_result(law, monkeypatch):
    """For wide limits around the direction of the Sun, precomputed fields give the same stars as the complete search."""
    wide = deg(-20, 20)
    envelope = plan(replace(REQUEST, attitude=AttitudeLimits(law, wide, wide, wide))).envelope
    stars = load_stars(5.0).icrs
    visible = envelope.contains(stars)
    monkeypatch.setattr("gss.catalogue_tools.envelope.envelope.WITNESSES", 0)
    assert np.array_equal(envelope.contains(stars), visible)
    assert 0 < np.count_nonzero(visible) < len(stars)


def test_a_drifting_node_widens_the_limits():
    """With a known altitude, the node's limits include the drift caused by the Earth's flattening during the validity.
    Without an altitude they do not change.
    """
    orbit = ElementsOrbit(deg(97.6, 97.6), deg(50, 50), 557e3)
    low, high = plan(replace(REQUEST, orbit=orbit)).planes.raan_rad
    assert low == pytest.approx(np.radians(50))
    assert np.degrees(high - low) == pytest.approx(14 * 0.985, rel=0.02)  # degrees per day of a Sun-synchronous orbit
    without_altitude = plan(replace(REQUEST, orbit=replace(orbit, altitude_m=None))).planes.raan_rad
    assert without_altitude[0] == without_altitude[1]


def test_requests_are_restored_from_their_parameters():
    """A request restored from its parameters equals the original.

    Invalid parameters and another camera are rejected.
    """
    changed = replace(REQUEST, occultation=Occultation(8e5, 0.0, 0.4, 0.2), k_vector=True, orbit=TleOrbit("x"))
    for request in (REQUEST, changed, BuildRequest(shipped_camera("cubestar"), "cubestar", SelectionRules(3.8))):
        assert request_from(json.loads(json.dumps(parameters_of(request))), request.profile) == request
    with pytest.raises(CorruptData, match="not a valid request"):
        request_from({"rules": {"colour": 1}}, REQUEST.profile)
    with pytest.raises(CorruptData, match="the camera is"):
        request_from(parameters_of(REQUEST), shipped_camera("aim"))


def test_a_manifest_of_version_1_is_read():
    """A manifest without the newer fields is read unchanged and keeps its hash."""
    content = build(REQUEST, load_stars()).manifest.as_dict()
    old = {name: value for name, value in content.items() if name not in (*SINCE_2, "manifest_sha256")} | {"version": 1}
    text = json.dumps(old, sort_keys=True, separators=(",", ":"), ensure_ascii=False)
    manifest = json.dumps(old | {"manifest_sha256": hashlib.sha256(text.encode()).hexdigest()})
    read = read_manifest(manifest)
    assert (read.version, read.corrections, read.method) == (1, {}, "exact")
    assert read.as_dict() == json.loads(manifest)
    assert request_from(read.parameters, REQUEST.profile) == REQUEST


def test_the_default_build_keeps_its_bytes():
    """The example of the documents gives the same image as before corrections were added."""
    request = replace(REQUEST, rules=SelectionRules(6.0))
    assert build(request, load_stars()).sha256 == "b41e1832fd0b29fa0f0b1b89b13bb77291a08e6614b906ca2ce8beb753d2a254"
    assert preview(request, load_stars()).pairs == 2783
