"""Directions of orbiting objects compared with astropy, identification of measured tracks, and tracks as CCSDS TDM."""

from __future__ import annotations

from datetime import UTC, datetime

import numpy as np
import pytest
from astropy import units as u
from astropy.coordinates import GCRS, TEME, CartesianRepresentation, EarthLocation
from astropy.time import Time

from gss.catalogue_tools.corrections.ephemeris import bodies_at, earth_motion
from gss.catalogue_tools.envelope.orbits import jyear_of
from gss.domain.aberration import aberrate
from gss.domain.angles import ARCSEC_RAD, Array, separation_rad
from gss.domain.errors import BadInput
from gss.domain.rotation import matrix_from_quaternion
from gss.orbit.objects import MeasuredTrack, catalogue_of, name_of, places_of_orbit, places_of_station, read_objects
from gss.orbit.station import GroundStation
from gss.orbit.tdm import TdmTrack, tdm_of
from gss.orbit.trajectory import TleTrajectory
from gss.pipeline.attitude import q_method

MOMENT = datetime(2026, 3, 1, 13, tzinfo=UTC)
TIMES_S = MOMENT.timestamp() + np.array([0.0, 1.0, 2.0])


def element_set(number: int, anomaly_deg: float) -> str:
    """Return an element set with its name and valid checksums."""
    first = f"1 {number:05d}U 98067A   26060.50000000  .00000000  00000-0  00000-0 0  999"
    second = f"2 {number:05d}  51.6400 208.9163 0006703  69.9862 {anomaly_deg:8.4f} 15.4956053200001"
    lines = [f"{line}{sum(int(c) if c.isdigit() else c == '-' for c in line) % 10}" for line in (first, second)]
    return f"OBJECT {number}\n" + "\n".join(lines) + "\n"


OBSERVER, TARGET = element_set(10001, 25.0), element_set(10002, 31.0)


def test_a_direction_agrees_with_astropy() -> None:
    """The direction from a ground site, including light time, agrees with astropy's conversion from TEME to GCRS within
    100 m at the object.
    """
    station = GroundStation("roof", 0.6, 0.3, 100.0)
    catalogue = catalogue_of(read_objects(TARGET))
    directions, distance_km = catalogue.seen_from(TIMES_S, places_of_station(station, TIMES_S))
    time = Time(TIMES_S[0], format="unix", scale="utc")
    emitted_s = TIMES_S[0] - distance_km[0, 0] / 299792.458
    teme = TleTrajectory.of(TARGET).teme_km(np.array([emitted_s]))[0]
    object_gcrs = TEME(CartesianRepresentation(*(teme * u.km)), obstime=time).transform_to(GCRS(obstime=time))
    site = EarthLocation.from_geodetic(0.3 * u.rad, 0.6 * u.rad, 100 * u.m).get_gcrs(time)
    expected = (object_gcrs.cartesian - site.cartesian).xyz.to_value(u.km)
    separation = separation_rad(directions[0, 0], expected / np.linalg.norm(expected))
    # Only astropy applies UT1 and polar motion to the site: 0.1 s of rotation is 50 m.
    assert separation * distance_km[0, 0] < 0.1


def measured(elements: str, offset_rad: float = 0.0) -> MeasuredTrack:
    """Return the track of an object as measured by the observer relative to catalogue stars, with an offset in direction."""
    observer_positions = places_of_orbit(TleTrajectory.of(OBSERVER), TIMES_S)
    directions, _ = catalogue_of(read_objects(elements)).seen_from(TIMES_S, observer_positions)
    seen = aberrate(directions[0], -earth_motion(jyear_of(MOMENT))[1])
    icrs: Array = seen + offset_rad * np.array([0.0, 0.0, 1.0])
    return MeasuredTrack(
        TIMES_S, icrs / np.linalg.norm(icrs, axis=1, keepdims=True), np.full(3, 5 * ARCSEC_RAD), observer_positions
    )


def test_an_object_is_identified_only_at_its_predicted_position() -> None:
    """A track at the predicted position is identified with the object. One degree away, or without the observer's
    position, it is not identified.
    """
    catalogue = catalogue_of(read_objects(TARGET + element_set(10003, 200.0)))
    name = name_of(measured(TARGET), catalogue)
    assert name is not None
    assert (name.name, name.number) == ("OBJECT 10002", "10002")
    assert name.off_rad < ARCSEC_RAD
    assert name_of(measured(TARGET, float(np.radians(1.0))), catalogue) is None
    track = measured(TARGET)
    assert name_of(MeasuredTrack(track.times_s, track.icrs, track.sigma_rad, None), catalogue) is None


def test_an_attitude_without_correction_displaces_an_object_by_the_aberration() -> None:
    """An attitude from displaced stars and their catalogue directions gives an object the same direction as an attitude that is
    corrected for aberration, within 1″, and the prediction agrees with it."""
    observer_positions = places_of_orbit(TleTrajectory.of(OBSERVER), TIMES_S)
    directions, _ = catalogue_of(read_objects(TARGET)).seen_from(TIMES_S, observer_positions)
    around = directions[0].mean(axis=0) + np.radians(4) * np.random.default_rng(1).normal(size=(200, 3))
    stars = around / np.linalg.norm(around, axis=1, keepdims=True)
    camera = aberrate(stars, earth_motion(jyear_of(MOMENT))[1])  # the axes of the camera are those of ICRS
    measured_icrs = directions[0] @ matrix_from_quaternion(q_method(camera, stars))
    assert separation_rad(measured_icrs, directions[0]).max() > 5 * ARCSEC_RAD
    assert separation_rad(measured_icrs, measured(TARGET).icrs).max() < ARCSEC_RAD
    track = MeasuredTrack(TIMES_S, measured_icrs, np.full(3, ARCSEC_RAD), observer_positions)
    name = name_of(track, catalogue_of(read_objects(TARGET)))
    assert name is not None
    assert name.off_rad < ARCSEC_RAD


def test_a_planet_is_identified_without_the_observers_position() -> None:
    """A track in the direction of Jupiter is identified, also without the observer's position."""
    jupiter = bodies_at(jyear_of(MOMENT)).planets_icrs[3]
    track = MeasuredTrack(TIMES_S, np.tile(jupiter, (3, 1)), np.full(3, ARCSEC_RAD), None)
    name = name_of(track, catalogue_of([]))
    assert name is not None
    assert name.name == "Jupiter"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("NAME\nNAME\n", "a name, line 1 and line 2"),
        (TARGET.replace("51.64", "51.65"), "checksum"),
        ("LAST\n", "after a name"),
    ],
)
def test_invalid_lists_are_rejected(text: str, message: str) -> None:
    """An invalid list is rejected, and the message names the invalid value."""
    with pytest.raises(BadInput, match=message):
        read_objects(text)


def test_tracks_are_written_as_tdm() -> None:
    """A TDM has one segment per object, angles in degrees and names in ASCII."""
    track = TdmTrack("Ørsted", TIMES_S, np.tile([0.0, -1.0, 0.0], (3, 1)), np.full(3, 4.25), ARCSEC_RAD)
    lines = "".join(tdm_of([track, track], "CAM", 0.5, MOMENT)).splitlines()
    assert lines[0] == "CCSDS_TDM_VERS = 2.0"
    assert lines.count("META_START") == lines.count("DATA_STOP") == 2
    assert "PARTICIPANT_2 = _rsted" in lines
    assert "ANGLE_1 = 2026-03-01T13:00:00.000000 270.0000000" in lines
    assert "MAG = 2026-03-01T13:00:02.000000 4.25" in lines
