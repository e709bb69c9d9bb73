"""Vectors for attitude control: frames, aberration and the Earth's velocity, compared with astropy and ERFA."""

from __future__ import annotations

import erfa
import numpy as np
import pytest
from astropy.coordinates import get_body_barycentric_posvel
from astropy.time import Time, TimeDelta

from gss.domain.camera import Camera
from gss.domain.results import Attitude, Centroids, Matches, Outcome, SolveResult
from gss.domain.rotation import quaternion_from_matrix
from gss.instruments.registry import shipped_camera
from gss.pipeline.chains.sunsat_frames import OrbitElements, cam_from_icrs_of, euler_123
from gss.pipeline.chains.sunsat_vectors import (
    LIGHT_M_S,
    aberrated,
    earth_velocity_m_s,
    matched_vectors,
    velocity_orbit_m_s,
)

CAMERA: Camera = shipped_camera("sunsat").camera
ORBIT = OrbitElements(2.3, np.radians(97.0), 1.1)
ANGLES = (np.radians(3.0), np.radians(-2.0), np.radians(134.0))
DAY = 9000.5


@pytest.mark.parametrize("year", [1996, 2010, 2026, 2040])
def test_earth_velocity_agrees_with_astropy(year: int) -> None:
    """Over a year, the velocity agrees with the barycentric ephemeris within 30 m/s, or 0.02″ of aberration."""
    for day in range(0, 365, 20):
        time = Time(f"{year}-01-01T00:00:00", scale="tdb") + TimeDelta(day, format="jd")
        _, velocity = get_body_barycentric_posvel("earth", time, ephemeris="builtin")
        expected = velocity.get_xyz().to_value("m/s")
        assert np.linalg.norm(earth_velocity_m_s(float(time.jd - 2451545.0)) - expected) < 30


def test_aberration_agrees_with_erfa() -> None:
    """Thirty directions agree with the relativistic formula within 1 mas and are displaced towards the motion."""
    rng = np.random.default_rng(1)
    unit = rng.normal(size=(30, 3))
    unit /= np.linalg.norm(unit, axis=1, keepdims=True)
    velocity = np.array([25_000.0, -20_000.0, 18_000.0])
    beta = velocity / LIGHT_M_S
    expected = np.array([erfa.ab(u, beta, 1.0, np.sqrt(1 - beta @ beta)) for u in unit])
    apparent = aberrated(unit, velocity)
    np.testing.assert_allclose(apparent, expected, atol=5e-9)
    np.testing.assert_allclose(np.linalg.norm(apparent, axis=1), 1.0, atol=1e-14)
    assert np.all((apparent - unit) @ velocity >= 0)


def test_largest_aberration_agrees_with_the_document() -> None:
    """Perpendicular to the motion, the aberration is 20.5″ from the Earth's motion and 5.1″ from the satellite's
    (§7.5.1).
    """
    for speed, arcsec in ((29785.0, 20.5), (7400.0, 5.1)):
        apparent = aberrated(np.array([[0.0, 1.0, 0.0]]), np.array([speed, 0, 0]))[0]
        assert np.degrees(np.arctan2(apparent[0], apparent[1])) * 3600 == pytest.approx(arcsec, abs=0.05)


def _solution(aberration: bool) -> SolveResult:
    """Return a solution as the chain makes it, of stars seen from the orbit at the angles above."""
    attitude = cam_from_icrs_of(ORBIT, *ANGLES)
    rng = np.random.default_rng(2)
    icrs = CAMERA.unproject(rng.uniform((20, 20), (730, 560), (6, 2))) @ attitude
    velocity = ORBIT.orbit_from_icrs.T @ velocity_orbit_m_s(ORBIT, DAY)
    pixels = CAMERA.project((aberrated(icrs, velocity) if aberration else icrs) @ attitude.T)
    matches = Matches(
        np.arange(6, dtype=np.int32),
        np.arange(101, 107, dtype=np.int32),
        np.ones(6),
        pixels - CAMERA.project(icrs @ attitude.T),
    )
    return SolveResult(
        "sunsat",
        Outcome.SOLVED,
        "",
        CAMERA,
        (),
        Centroids.from_pixels(pixels),
        matches,
        Attitude(quaternion_from_matrix(attitude), np.eye(3) * 1e-9),
        0.0,
    )


def test_vectors_satisfy_the_attitude_equation() -> None:
    """If the image contains aberration, the observed body vectors are body_from_orbit times the reference vectors
    within 1e-9 (eq. 1.17).
    """
    vectors = matched_vectors(_solution(True), ORBIT, ANGLES, DAY)
    assert len(vectors) == 6
    assert vectors.hip.tolist() == [101, 102, 103, 104, 105, 106]
    np.testing.assert_allclose(vectors.observed_body, vectors.reference_orbit @ euler_123(*ANGLES).T, atol=1e-9)
    np.testing.assert_allclose(vectors.observed_orbit, vectors.reference_orbit, atol=1e-9)


def test_correction_of_an_image_without_aberration_is_visible() -> None:
    """If the image does not contain aberration, the corrected vectors differ from the reference by up to 26″."""
    vectors = matched_vectors(_solution(False), ORBIT, ANGLES, DAY)
    error_rad = np.linalg.norm(vectors.observed_orbit - vectors.reference_orbit, axis=1)
    assert np.degrees(error_rad.max()) * 3600 < 26
    assert error_rad.max() > 1e-6


def test_a_failed_frame_gives_no_vector() -> None:
    """Without matches, the list of vectors is empty (§4.1.7)."""
    result = _solution(True)
    unsolved = SolveResult("sunsat", Outcome.NONE, "dark", CAMERA, (), result.centroids, None, None, float("nan"))
    vectors = matched_vectors(unsolved, ORBIT, ANGLES, DAY)
    assert len(vectors) == 0
    assert vectors.reference_orbit.shape == (0, 3)
