"""Stars in view: curves compared with brute force and with the documents."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gss.catalogue_tools.design import in_view
from gss.catalogue_tools.design.camera import DesignCamera
from gss.catalogue_tools.design.design_report import QUICK, DesignRequest, design
from gss.catalogue_tools.envelope.attitude import AttitudeLimits
from gss.catalogue_tools.envelope.envelope import BandEnvelope
from gss.catalogue_tools.envelope.orbits import from_elements
from gss.catalogue_tools.sources.hipparcos import load_stars
from gss.domain.errors import BadInput
from gss.instruments.registry import shipped_camera

STARS = load_stars(7.0)
SUNSAT = DesignCamera.from_profile(shipped_camera("sunsat"))


def brute_force(camera: DesignCamera, attitudes: np.ndarray, rows: int) -> np.ndarray:
    """Return (m, rows): true for each star on the detector. Every star is projected."""
    pixels = np.stack([camera.camera.project(STARS.icrs[:rows] @ a.T) for a in attitudes])
    return camera.camera.contains(pixels)


def test_pairs_list_every_star_on_the_detector() -> None:
    """The pairs of 200 fields equal those of projecting the whole catalogue, in order of brightness within each field."""
    rows = in_view.bright_rows(STARS, 5.0)
    attitudes = in_view.look(SUNSAT, 200, 3)
    pairs = in_view.pairs_in_view(STARS.icrs[:rows], attitudes, SUNSAT.shape)
    field, star = np.nonzero(brute_force(SUNSAT, attitudes, rows))
    assert np.array_equal(pairs.field, field)
    assert np.array_equal(pairs.star, star)
    assert np.array_equal(pairs.count, np.bincount(field, minlength=200))


def test_curves_by_limit_circle_and_focal_length_equal_counts() -> None:
    """For each limit, circle and focal length, the share equals a count field by field."""
    rows = in_view.bright_rows(STARS, 6.0)
    attitudes = in_view.look(SUNSAT, 300, 5)
    pairs = in_view.pairs_in_view(STARS.icrs[:rows], attitudes, SUNSAT.shape)
    nth = in_view.nth_brightest_mag(pairs, STARS.v_mag)
    for limit in (4.5, 5.5):
        rows_to_limit = in_view.bright_rows(STARS, limit)
        counted = brute_force(SUNSAT, attitudes, rows_to_limit).sum(axis=1)
        assert in_view.p_fewer_by_limit(nth, 3, np.array([limit]))[0] == pytest.approx(np.mean(counted < 3))
    cosine = attitudes[:, 2] @ STARS.icrs[:rows].T
    nearest = in_view.nth_nearest_rad(STARS.icrs[:rows], attitudes[:, 2])
    for diameter in np.radians([6.0, 12.0]):
        inside = (cosine >= np.cos(diameter / 2)).sum(axis=1)
        assert in_view.p_fewer_in_circle(nearest, 5, np.array([diameter]))[0] == pytest.approx(np.mean(inside < 5))
    focal = np.array([20.0, 25.0, 50.0])
    shares = in_view.p_fewer_by_focal(STARS.icrs[:rows], attitudes, SUNSAT, focal, (3, 5))
    for k, f in enumerate(focal):
        counted = brute_force(SUNSAT.edited(focal_mm=float(f)), attitudes, rows).sum(axis=1)
        assert shares[:, k] == pytest.approx([np.mean(counted < 3), np.mean(counted < 5)])


def test_mean_by_limit_agrees_with_random_pointings() -> None:
    """The mean number of stars of 20 000 random pointings agrees with the solid angle of the field within their scatter. For
    each limit it is the mean of the pointings.
    """
    rows = in_view.bright_rows(STARS, 6.0)
    attitudes = in_view.look(SUNSAT, 20_000, 7)
    pairs = in_view.pairs_in_view(STARS.icrs[:rows], attitudes, SUNSAT.shape)
    mean = in_view.mean_by_limit(pairs, STARS.v_mag, np.array([5.0, 6.0]))
    expected = rows * SUNSAT.shape.area_sr / (4 * np.pi)
    assert mean[1] == pytest.approx(expected, abs=4 * pairs.count.std() / np.sqrt(20_000))
    assert mean[0] == pytest.approx(pairs.brighter_than(in_view.bright_rows(STARS, 5.0)).count.mean())


def test_the_curve_of_the_mean_uses_the_pointings_of_the_report() -> None:
    """With an orbit, the curve of the mean at the active limit is the mean number of stars along this orbit."""
    orbit = from_elements((np.radians(90.0),) * 2, (0.0, 0.0))
    limits = AttitudeLimits("zenith", (-0.09, 0.09), (-0.09, 0.09), (-0.09, 0.09))
    request = DesignRequest(SUNSAT, BandEnvelope(SUNSAT.shape, limits, orbit))
    report = design(request, STARS, replace(QUICK, looks=500))
    at_limit = int(np.argmin(abs(report.curves.limit_mag - report.limits.in_force_mag)))
    assert report.curves.mean_stars[at_limit] == pytest.approx(report.in_view.mean)


def test_histogram_of_jacobs_is_reproduced_with_progress() -> None:
    """Of 60 000 fields to V 6, 0.3 % to 0.65 % have fewer than three stars (paper: 0.56 %). Progress never decreases
    and ends at 1.
    """
    rows, progress = in_view.bright_rows(STARS, 6.0), []
    counts = in_view.count_stars(
        STARS.icrs[:rows], lambda k, m: in_view.look(SUNSAT, m, 100 + k), 60_000, SUNSAT.shape, map, progress.append
    )
    assert counts.pointings == counts.histogram.sum() == 60_000
    assert 0.003 < counts.p_fewer_than(3) < 0.0065
    assert progress == sorted(progress)
    assert progress[-1] == 1.0
    assert len(progress) > 3
    fewest_stars = np.flatnonzero(counts.histogram)[0]
    assert counts.worst_stars == fewest_stars


def test_a_cancellation_ends_the_count() -> None:
    """An exception raised by the progress callback ends the count."""

    class Stop(Exception):
        pass

    def stop(share: float) -> None:
        if share > 0:
            raise Stop

    with pytest.raises(Stop):
        in_view.count_stars(STARS.icrs[:500], lambda k, m: in_view.look(SUNSAT, m, k), 5_000, SUNSAT.shape, map, stop)


def test_pointings_along_an_orbit_stay_in_its_band() -> None:
    """A zenith camera on an equatorial orbit sees only declinations near zero. Zero pointings give an error."""
    limits = AttitudeLimits("zenith")
    band = BandEnvelope(SUNSAT.shape, limits, from_elements((0.0, 0.0), (0.0, 6.28)))
    assert np.abs(in_view.look(SUNSAT, 500, 1, band)[:, 2, 2]).max() < 1e-6
    assert np.abs(in_view.look(SUNSAT, 500, 1)[:, 2, 2]).max() > 0.9
    with pytest.raises(BadInput, match="number of pointings is out of range"):
        in_view.look(SUNSAT, 0, 1)
