"""Passes, compared with azimuth and elevation calculated by astropy from TEME, and properties of every pass."""

from datetime import UTC, datetime, timedelta

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import ITRS, TEME, AltAz, CartesianRepresentation, EarthLocation, get_sun
from astropy.time import Time
from scipy.optimize import brentq
from sgp4.api import Satrec

from gss.domain.errors import BadInput
from gss.orbit.passes import find_passes, sunlit_at
from gss.orbit.station import GroundStation, checked_station
from gss.orbit.trajectory import TleTrajectory, sun_teme_km

# The element set of 2019-12-09 from the documentation of the sgp4 package.
TLE = """ISS (ZARYA)
1 25544U 98067A   19343.69339541  .00001764  00000-0  38792-4 0  9991
2 25544  51.6439 211.2001 0007417  17.6667  85.6398 15.50103472202482
"""
START = datetime(2019, 12, 10, tzinfo=UTC)
STELLENBOSCH = GroundStation("Stellenbosch", np.radians(-33.9275), np.radians(18.865), 136.0, np.radians(5.0))


def astropy_elevation_deg(station: GroundStation, unix_s: float) -> tuple[float, float]:
    """Return elevation and azimuth calculated by astropy from SGP4's position, through TEME, ITRS and AltAz, with its
    Earth-rotation tables.
    """
    time = Time(unix_s, format="unix", scale="utc")
    error, position_km, _ = Satrec.twoline2rv(*TLE.strip().splitlines()[1:]).sgp4(time.jd1, time.jd2)
    assert error == 0
    location = EarthLocation.from_geodetic(
        np.degrees(station.longitude_rad), np.degrees(station.latitude_rad), station.height_m
    )
    teme = TEME(CartesianRepresentation(np.array(position_km) * u.km), obstime=time)
    itrs = teme.transform_to(ITRS(obstime=time))
    topocentric = itrs.cartesian.xyz - location.get_itrs(time).cartesian.xyz
    frame = AltAz(obstime=time, location=location)
    horizontal = ITRS(topocentric, obstime=time, location=location).transform_to(frame)
    return float(horizontal.alt.deg), float(horizontal.az.deg)


def test_rise_and_set_agree_with_astropy_within_a_second() -> None:
    """Every rise, set and maximum elevation of two days over a southern station agrees with astropy."""
    passes = find_passes(TleTrajectory.of(TLE), STELLENBOSCH, START, START + timedelta(days=2))
    assert len(passes) >= 8
    low_deg = np.degrees(STELLENBOSCH.min_elevation_rad)
    for single_pass in passes:
        for crossing in (single_pass.rise, single_pass.set):
            at_s = crossing.timestamp()
            expected_s = brentq(
                lambda t: astropy_elevation_deg(STELLENBOSCH, t)[0] - low_deg, at_s - 20, at_s + 20, xtol=1e-3
            )
            assert abs(at_s - expected_s) < 1.0
        elevation, azimuth = astropy_elevation_deg(STELLENBOSCH, single_pass.culmination.timestamp())
        assert elevation == pytest.approx(np.degrees(single_pass.max_elevation_rad), abs=0.02)
        difference = (azimuth - np.degrees(single_pass.culmination_azimuth_rad) + 180) % 360 - 180
        assert abs(difference) * np.cos(single_pass.max_elevation_rad) < 0.05


def test_no_pass_is_missed() -> None:
    """Each minute of a day is in a pass exactly if the elevation calculated by astropy is above the minimum."""
    passes = find_passes(TleTrajectory.of(TLE), STELLENBOSCH, START, START + timedelta(days=1))
    for minute in range(1440):
        at_s = START.timestamp() + 60 * minute
        inside = any(p.rise.timestamp() <= at_s <= p.set.timestamp() for p in passes)
        if minute % 7 and not inside:
            continue
        elevation, _ = astropy_elevation_deg(STELLENBOSCH, at_s)
        if abs(elevation - 5.0) > 0.05:
            assert (elevation > 5.0) == inside, minute


def test_the_times_of_a_pass_do_not_depend_on_the_searched_span() -> None:
    """A search that starts later finds the same passes with the same times."""
    orbit, end = TleTrajectory.of(TLE), START + timedelta(days=1)
    first, *later = find_passes(orbit, STELLENBOSCH, START, end)
    for start in (first.set + timedelta(seconds=k * 7.3) for k in (1, 2, 3)):
        assert find_passes(orbit, STELLENBOSCH, start, end) == later


def test_sun_and_shadow_agree_with_astropy() -> None:
    """The Sun's direction agrees with astropy's within 0.01°. The shadow is a cylinder without the penumbra."""
    sun = sun_teme_km(START)
    expected = get_sun(Time(START)).transform_to(TEME(obstime=Time(START))).cartesian.xyz.to_value(u.km)
    cosine = sun @ expected / np.linalg.norm(sun) / np.linalg.norm(expected)
    assert np.degrees(np.arccos(cosine)) < 0.01
    times_s = START.timestamp() + np.arange(0, 5575, 5.0)
    positions_km = TleTrajectory.of(TLE).teme_km(times_s)
    along_sun = positions_km @ expected / np.linalg.norm(expected)
    behind = (along_sun < 0) & (np.linalg.norm(positions_km, axis=1) ** 2 - along_sun**2 < 6378.137**2)
    lit = sunlit_at(positions_km, sun)
    assert 0 < (lit & behind).sum() * 5.0 < 30  # the penumbra of two crossings
    assert not (~lit & ~behind).any()


def test_a_horizon_mask_shortens_passes() -> None:
    """A hill hides the low part of passes in its direction. A mask below the minimum elevation has no effect."""
    orbit, end = TleTrajectory.of(TLE), START + timedelta(days=2)
    without_mask = find_passes(orbit, STELLENBOSCH, START, end)
    low_mask = GroundStation(**{**vars(STELLENBOSCH), "mask": ((0.0, 0.01), (3.0, 0.02))})
    assert [p.rise for p in find_passes(orbit, low_mask, START, end)] == [p.rise for p in without_mask]
    north = ((0.0, 0.5), (0.5, 0.5), (0.6, 0.0), (5.6, 0.0), (5.7, 0.5))
    hill = GroundStation(**{**vars(STELLENBOSCH), "mask": north})
    with_hill = find_passes(orbit, hill, START, end)
    assert sum(p.duration_s for p in with_hill) < sum(p.duration_s for p in without_mask) - 60
    for single_pass in with_hill:
        azimuths = np.array([t.azimuth_rad for t in single_pass.track[1:-1]])
        elevations = np.array([t.elevation_rad for t in single_pass.track[1:-1]])
        assert (elevations >= hill.horizon_rad(azimuths) - 1e-4).all()


def test_a_pass_that_extends_beyond_the_span_is_marked() -> None:
    """A pass that begins before the span or ends after it is marked accordingly."""
    orbit = TleTrajectory.of(TLE)
    single_pass = max(find_passes(orbit, STELLENBOSCH, START, START + timedelta(days=1)), key=lambda p: p.duration_s)
    middle = single_pass.rise + (single_pass.set - single_pass.rise) / 2
    (clipped,) = find_passes(orbit, STELLENBOSCH, middle - timedelta(seconds=20), middle + timedelta(seconds=20))
    assert (clipped.begins_before, clipped.ends_after) == (True, True)
    assert not single_pass.begins_before
    assert not single_pass.ends_after


def test_times_outside_the_validity_of_the_elements_are_rejected() -> None:
    """Passes of 2026 are not calculated from elements of 2019. The error states the validity and advises newer
    elements.
    """
    with pytest.raises(BadInput, match="outside the validity") as raised:
        find_passes(
            TleTrajectory.of(TLE), STELLENBOSCH, datetime(2026, 1, 1, tzinfo=UTC), datetime(2026, 1, 2, tzinfo=UTC)
        )
    assert "2020-02-07" in raised.value.expected
    assert "newer elements" in raised.value.hint


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"latitude_rad": 2.0}, "latitude"),
        ({"longitude_rad": float("nan")}, "longitude"),
        ({"height_m": 1e6}, "height"),
        ({"min_elevation_rad": -0.2}, "minimum elevation"),
        ({"mask": ((1.0, 0.1), (1.0, 0.1))}, "do not increase"),
        ({"mask": ((7.0, 0.1),)}, "azimuth of the mask"),
        ({"mask": tuple((k / 100, 0.0) for k in range(361))}, "too many points"),
    ],
)
def test_a_station_with_an_invalid_number_is_rejected(change: dict[str, object], message: str) -> None:
    """A station with an invalid number is rejected, and the error names the number."""
    with pytest.raises(BadInput, match=message):
        checked_station(GroundStation(**{**vars(STELLENBOSCH), **change}))
