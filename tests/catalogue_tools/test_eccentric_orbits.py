"""Eccentric orbits and the drift of the perigee, compared with brute force in time and with sgp4."""

from __future__ import annotations

from dataclasses import asdict, replace
from datetime import UTC, datetime

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.integrate import quad
from scipy.optimize import brentq
from sgp4.api import Satrec

from gss.catalogue_tools.envelope.attitude import AttitudeLimits, euler_123
from gss.catalogue_tools.envelope.ellipse import (
    EARTH_RADIUS_M,
    Ellipse,
    node_rate_rad_s,
    perigee_rate_rad_s,
    true_anomaly_rad,
)
from gss.catalogue_tools.envelope.envelope import BandEnvelope, PatchEnvelope
from gss.catalogue_tools.envelope.field import FieldShape
from gss.catalogue_tools.envelope.healpix import centres
from gss.catalogue_tools.envelope.occultation import Occultation, OccultedEnvelope
from gss.catalogue_tools.envelope.orbits import OrbitRanges, from_elements, from_tle
from gss.catalogue_tools.plan import planes_of
from gss.catalogue_tools.request import ElementsOrbit, _orbit_from
from gss.domain.angles import Array
from gss.domain.errors import BadInput
from gss.domain.frames import orbit_from_icrs
from gss.instruments.registry import shipped_camera
from gss.operations.catalogues.catalogue_request import CatalogueRequest, build_request

DAY_S = 86400.0
START = datetime(2026, 12, 1, tzinfo=UTC)
CUBESTAR = FieldShape(shipped_camera("cubestar").camera)
ZENITH = AttitudeLimits("zenith", (-0.1, 0.1), (-0.1, 0.1), (-0.1, 0.1))
TILTED = AttitudeLimits("zenith", (1.1, 1.3), (-0.05, 0.05), (-0.1, 0.1))
UNIT = centres(24)


def elements(
    eccentricity: float, perigee_deg: float, altitude_m: float = 20_188e3, i_deg: float = 63.4
) -> ElementsOrbit:
    """Return an orbit; by default with the period of a Molniya orbit."""
    inclination, perigee = np.radians(i_deg), np.radians(perigee_deg)
    return ElementsOrbit((inclination, inclination), (0.3, 0.5), altitude_m, eccentricity, perigee)


def brute_force(
    orbit: ElementsOrbit, limits: AttitudeLimits, days: float, count: int, rng: np.random.Generator
) -> tuple[Array, Array, Array]:
    """Return (n, 3, 3) attitudes, (n, 3) nadirs and (n,) distances in m at random times, from the equations of Moniteq 1983
    §2.3 and §2.5, with Kepler's equation solved by bisection."""
    assert orbit.altitude_m is not None
    e, i = orbit.eccentricity, orbit.inclination_rad[0]
    ratio = EARTH_RADIUS_M / (EARTH_RADIUS_M + orbit.altitude_m)
    size = ratio**3.5 / (1 - e * e) ** 2
    node_rate, perigee_rate = -9.97 * size * np.cos(i), 4.98 * size * (5 * np.cos(i) ** 2 - 1)
    cams, nadirs, distances = [], [], []
    for _ in range(count):
        day, mean = rng.uniform(0, days), rng.uniform(0, 2 * np.pi)
        eccentric = brentq(lambda x, m=mean: x - e * np.sin(x) - m, 0, 2 * np.pi)
        x, y = np.cos(eccentric) - e, np.sqrt(1 - e * e) * np.sin(eccentric)
        latitude = orbit.perigee_rad + np.radians(perigee_rate * day) + np.arctan2(y, x)
        node = rng.uniform(*orbit.raan_rad) + np.radians(node_rate * day)
        axes = orbit_from_icrs(node, i, latitude)
        cams.append(limits.cam_from_body @ euler_123(rng.uniform(limits.low, limits.high)) @ axes)
        nadirs.append(axes[2])
        distances.append(EARTH_RADIUS_M / ratio * np.hypot(x, y))
    return np.array(cams), np.array(nadirs), np.array(distances)


def seen(unit: Array, cams: Array, nadirs: Array, limit_rad: Array) -> NDArray[np.bool_]:
    """Return the (n, m) mask of the m moments at which each direction is in a usable field and clear of the Earth."""
    usable = (cams[:, 2] * nadirs).sum(axis=1) <= np.cos(limit_rad)
    inside = np.stack([CUBESTAR.inside(unit @ cam.T) for cam in cams], axis=1)
    return np.asarray(inside & (unit @ nadirs.T <= np.cos(limit_rad)) & usable)


@given(st.floats(0, 0.95), st.floats(-20, 20))
def test_true_anomaly_obeys_keplers_law_of_areas(eccentricity: float, mean_rad: float) -> None:
    """The area swept since perigee is proportional to the mean anomaly."""
    anomaly = float(true_anomaly_rad(np.array([mean_rad]), eccentricity)[0])
    # The interval is 0 to 1, because quad warns about one of 1e-307 rad.
    area = anomaly * quad(lambda part: 1 / (1 + eccentricity * np.cos(part * anomaly)) ** 2, 0, 1, limit=400)[0]
    assert area * (1 - eccentricity**2) ** 1.5 == pytest.approx(mean_rad, abs=1e-7)


def test_drifts_are_those_of_the_document() -> None:
    """The constants −9.97 and 4.98 degrees per day, RADARSAT's node, and the critical inclination (Moniteq 1983 §2.5)."""
    assert np.degrees(node_rate_rad_s(np.radians(99.49), 1001.3e3)) * DAY_S == pytest.approx(0.986, abs=0.002)
    for e, altitude_m, i_deg in ((0.0, 500e3, 20.0), (0.3, 1500e3, 97.0), (0.7, 20_000e3, 50.0)):
        i, size = np.radians(i_deg), (6378e3 / (EARTH_RADIUS_M + altitude_m)) ** 3.5 / (1 - e * e) ** 2
        node, perigee = (np.degrees(rate(i, altitude_m, e)) * DAY_S for rate in (node_rate_rad_s, perigee_rate_rad_s))
        assert node == pytest.approx(-9.97 * size * np.cos(i), rel=2e-3)
        assert perigee == pytest.approx(4.98 * size * (5 * np.cos(i) ** 2 - 1), rel=2e-3)
    assert perigee_rate_rad_s(np.arccos(np.sqrt(0.2)), 1e7, 0.5) == pytest.approx(0, abs=1e-20)


@settings(max_examples=12, deadline=None)
@given(
    st.floats(0.01, 0.7),
    st.floats(0, 360),
    st.floats(1, 400),
    st.floats(20, 110),
    st.floats(0, 25),
    st.sampled_from([ZENITH, TILTED]),
    st.integers(0, 1000),
)
def test_the_envelope_covers_every_sampled_pointing(
    eccentricity: float,
    perigee_deg: float,
    days: float,
    inclination_deg: float,
    margin_deg: float,
    limits: AttitudeLimits,
    seed: int,
) -> None:
    """Every direction that brute force sees past the Earth at any time of the mission is in the envelope, with its node and
    perigee drifting."""
    altitude_m = (EARTH_RADIUS_M + 300e3) / (1 - eccentricity) - EARTH_RADIUS_M
    orbit = elements(eccentricity, perigee_deg, altitude_m, inclination_deg)
    planes = planes_of(orbit, START, days)
    occultation = Occultation(altitude_m, float(np.radians(margin_deg)))
    assert planes is not None
    envelope = OccultedEnvelope(BandEnvelope(CUBESTAR, limits, planes), occultation, planes)
    cams, nadirs, distances = brute_force(orbit, limits, days, 400, np.random.default_rng(seed))
    limit_rad = np.arcsin(EARTH_RADIUS_M / distances) + np.radians(margin_deg)
    visible = seen(UNIT, cams, nadirs, limit_rad).any(axis=1)
    # The node's drift rates of the document and of GSS differ by up to 0.2 %, which is tested above.
    slack_rad = abs(np.radians(0.02) * days / 50) + 1e-6
    nearest = UNIT[envelope.contains(UNIT)]
    missing = UNIT[visible & ~envelope.contains(UNIT)]
    assert len(missing) == 0 or (nearest @ missing.T).max(axis=0).min() > np.cos(slack_rad + np.radians(2.5))
    assert len(missing) <= 0.01 * max(1, visible.sum())


def test_a_circle_of_the_mean_altitude_misses_stars() -> None:
    """Near apogee the Earth's disc is smaller. The envelope of a circular orbit with the same semi-major axis lacks directions
    that are seen there past the limb."""
    orbit, limits = elements(0.6, 270.0, 10_000e3), AttitudeLimits("nadir", (0.3, 0.38), (-0.1, 0.1), (-0.1, 0.1))
    planes = planes_of(orbit, START, 30)
    assert planes is not None
    cams, nadirs, distances = brute_force(orbit, limits, 30, 600, np.random.default_rng(1))
    visible = seen(UNIT, cams, nadirs, np.arcsin(EARTH_RADIUS_M / distances)).any(axis=1)
    missed = []
    for used in (planes, replace(planes, ellipse=None)):
        envelope = OccultedEnvelope(BandEnvelope(CUBESTAR, limits, used), Occultation(10_000e3), used)
        missed.append(int((visible & ~envelope.contains(UNIT)).sum()))
    assert missed[0] == 0
    assert missed[1] > 100


@pytest.mark.parametrize("days", [1.0, 200.0])
def test_fractions_of_time_agree_with_brute_force(days: float) -> None:
    """The satellite is longer near apogee: the fractions of time of directions, and of fields blinded by the Earth, agree with
    brute force within the errors of sampling, also while node and perigee drift over a long mission."""
    orbit = elements(0.7, 250.0, 18_000e3, 28.0)
    planes = planes_of(orbit, START, days)
    assert planes is not None
    band = BandEnvelope(CUBESTAR, ZENITH, planes)
    cams, nadirs, distances = brute_force(orbit, ZENITH, days, 1500, np.random.default_rng(2))
    expected = np.mean([CUBESTAR.inside(UNIT @ cam.T) for cam in cams], axis=0)
    ours = band.time_fraction(UNIT)
    sigma = np.sqrt(np.maximum(expected, 1e-3) * (1 - expected) * (1 / 1500 + 1 / 20_000))
    assert np.abs(ours - expected).max() < 6 * sigma.max()
    assert np.mean(np.abs(ours - expected) > 3 * sigma) < 0.02
    if days < 10:
        circle = BandEnvelope(CUBESTAR, ZENITH, replace(planes, ellipse=None)).time_fraction(UNIT)
        assert np.abs(circle - ours).max() > 0.1
    nadir_law = AttitudeLimits("nadir", (0.5, 0.7))
    tilted = OccultedEnvelope(BandEnvelope(CUBESTAR, nadir_law, planes), Occultation(18_000e3), planes)
    cams, nadirs, distances = brute_force(orbit, nadir_law, days, 1500, np.random.default_rng(3))
    blinded = (cams[:, 2] * nadirs).sum(axis=1) > np.sqrt(1 - (EARTH_RADIUS_M / distances) ** 2)
    assert 0.02 < blinded.mean() < 0.98
    assert tilted.blinded.earth == pytest.approx(float(blinded.mean()), abs=0.03)


def test_an_inertial_camera_sees_past_the_disc_of_each_moment() -> None:
    """For a law that does not follow the orbit, the Earth's direction and size also follow the ellipse."""
    orbit = elements(0.7, 90.0, 18_000e3, 28.0)
    planes = planes_of(orbit, START, 1.0)
    assert planes is not None
    limits = AttitudeLimits("inertial", ra_rad=4.0, dec_rad=-0.3)
    envelope = OccultedEnvelope(PatchEnvelope(CUBESTAR, limits), Occultation(18_000e3), planes)
    moments = envelope.at(np.random.default_rng(1).random((20_000, envelope.dimensions)))
    _, nadirs, distances = brute_force(orbit, ZENITH, 1.0, 1500, np.random.default_rng(4))
    boresight = moments.cam_from_icrs[0, 2]
    blinded = nadirs @ boresight > np.sqrt(1 - (EARTH_RADIUS_M / distances) ** 2)
    assert envelope.blinded.earth == pytest.approx(float(blinded.mean()), abs=0.02)


def test_a_small_eccentricity_is_a_circle() -> None:
    """The fractions of time of an almost circular orbit are those of a circle, and eccentricity 0 has no ellipse."""
    planes = planes_of(elements(0.0, 90.0), START, 14)
    assert planes is not None
    assert planes.ellipse is None
    nearly = replace(planes, ellipse=Ellipse(1e-6, 20_188e3, 0.0, 0.0))
    circle, ellipse = (BandEnvelope(CUBESTAR, ZENITH, p).time_fraction(UNIT) for p in (planes, nearly))
    assert np.abs(circle - ellipse).max() < 0.02
    assert (
        BandEnvelope(CUBESTAR, ZENITH, nearly).contains(UNIT) == BandEnvelope(CUBESTAR, ZENITH, planes).contains(UNIT)
    ).all()


MOLNIYA = """1 25847U 99036A   19343.50000000  .00000100  00000-0  00000-0 0  9994
2 25847  63.3000  10.0000 7000000 270.0000  10.0000  2.00600000150005
"""


def test_a_tle_gives_the_ellipse_and_its_drift() -> None:
    """The ellipse of an eccentric TLE has sgp4's mean elements and its drift of the perigee. A nearly circular one has none."""
    lines = MOLNIYA.splitlines()
    text = "\n".join(f"{line[:68]}{sum(int(c) if c.isdigit() else c == '-' for c in line[:68]) % 10}" for line in lines)
    start, days = datetime(2019, 12, 10, tzinfo=UTC), 30.0
    planes, satellite = from_tle(text, start, days), Satrec.twoline2rv(*text.splitlines())
    ellipse = planes.ellipse
    assert ellipse is not None
    assert ellipse.eccentricity == pytest.approx(0.7)
    assert ellipse.altitude_m == pytest.approx(satellite.a * EARTH_RADIUS_M - EARTH_RADIUS_M)
    drift = (ellipse.perigee_end_rad - ellipse.perigee_start_rad) / days / DAY_S
    assert drift == pytest.approx(satellite.argpdot / 60)
    assert drift == pytest.approx(perigee_rate_rad_s(np.radians(63.3), ellipse.altitude_m, 0.7), abs=2e-10)
    circular = text.replace(" 7000000 ", " 0007000 ")
    circular = "\n".join(
        f"{line[:68]}{sum(int(c) if c.isdigit() else c == '-' for c in line[:68]) % 10}"
        for line in circular.splitlines()
    )
    assert from_tle(circular, start, days).ellipse is None


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"altitude_km": None}, "needs the altitude"),
        ({"eccentricity": 0.9}, "perigee is too low"),
    ],
)
def test_impossible_ellipses_are_rejected(change: dict[str, float | None], message: str) -> None:
    """An eccentric orbit needs an altitude, and its perigee must be above the atmosphere."""
    spec = CatalogueRequest(
        orbit="elements", altitude_km=20_188, eccentricity=0.7, perigee_deg=270.0, start="2026-12-01"
    )
    with pytest.raises(BadInput, match=message):
        build_request(spec.model_copy(update=change), shipped_camera("cubestar"), "", START)


def test_a_request_keeps_its_ellipse_in_the_manifest() -> None:
    """The orbit of a request is read back from the manifest's parameters; those of earlier versions are circular."""
    orbit = elements(0.7, 270.0)
    assert _orbit_from(asdict(orbit)) == orbit
    old = {name: value for name, value in asdict(orbit).items() if name not in ("eccentricity", "perigee_rad")}
    assert _orbit_from(old) == replace(orbit, eccentricity=0.0, perigee_rad=0.0)
    plain = from_elements(orbit.inclination_rad, orbit.raan_rad)
    assert isinstance(plain, OrbitRanges)
    assert plain.ellipse is None
