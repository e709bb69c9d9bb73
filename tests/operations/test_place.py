"""Camera position from orbital elements, compared with SGP4 in astropy's frames and the simulator's orbit."""

from __future__ import annotations

import warnings
from datetime import UTC, datetime, timedelta
from types import SimpleNamespace

import numpy as np
import pytest
from astropy import units as u
from astropy.coordinates import GCRS, TEME, CartesianRepresentation
from astropy.time import Time
from astropy.utils import iers
from sgp4.api import Satrec

from gss.domain.errors import BadInput
from gss.instruments.dictionary.read_dictionary import load_dictionary
from gss.instruments.operations import Operation
from gss.instruments.roles import default_roles
from gss.operations.frames import place as place_of
from gss.operations.frames.place import Place, PlaceService, circular_km, tle_km
from gss.store.models import Command

TLE = """1 25544U 98067A   26325.50000000  .00010000  00000-0  18000-3 0  9990
2 25544  51.6400 200.0000 0005000  50.0000 310.0000 15.50000000    10"""


def checked(text: str) -> str:
    """Return the lines with corrected checksums."""

    def fix(line: str) -> str:
        return line[:68] + str(sum(int(c) if c.isdigit() else c == "-" for c in line[:68]) % 10)

    return "\n".join(fix(line) for line in text.splitlines())


def test_a_two_line_element_set_gives_the_position_of_astropy():
    """The position of a TLE in ICRS is within 100 m of astropy's transformation from TEME."""
    moment = datetime(2026, 11, 22, 3, 4, 5, tzinfo=UTC)
    at = Time(moment)
    lines = checked(TLE).splitlines()
    error, place, _ = Satrec.twoline2rv(*lines).sgp4(at.jd1, at.jd2)
    assert error == 0
    teme = TEME(CartesianRepresentation(np.array(place) * u.km), obstime=at)
    # astropy's prediction of the Earth's rotation is as old as its release, which causes an error of some metres.
    offline = iers.conf.set_temp("auto_download", False), iers.conf.set_temp("auto_max_age", None)
    with offline[0], offline[1], warnings.catch_warnings():
        warnings.simplefilter("ignore")
        expected_km = teme.transform_to(GCRS(obstime=at)).cartesian.xyz.to_value(u.km)
    assert np.linalg.norm(tle_km(checked(TLE), moment) - expected_km) < 0.1


def test_a_commanded_orbit_equals_the_simulators_circle():
    """The elements of SET_ORBIT give the position of the simulator's orbit within 50 m."""
    from gss.device.simulator.orbit import CircularOrbit

    orbit = {"raan_deg": 84.0, "inclination_deg": 97.8, "latitude_deg": 30.0, "altitude_km": 600.0, "epoch_s": 100.0}
    simulated = CircularOrbit(start_rad=np.radians(30.0))
    for after_s in (0.0, 777.0, 6000.0):
        assert np.linalg.norm(circular_km(orbit, 100.0 + after_s) - simulated.state(after_s)[0]) < 0.05


def test_the_earth_disc_has_the_direction_and_size_for_the_height():
    """From 600 km the limb is asin(R / (R + h)) from the centre, and the centre is opposite to the position."""
    place = Place(np.array([0.0, 6978.137, 0.0]), "")
    assert place.earth_icrs == pytest.approx([0, -1, 0])
    assert place.earth_radius_rad == pytest.approx(np.arcsin(6378.137 / 6978.137))


@pytest.mark.parametrize(
    ("more", "source"),
    [({}, "orbit from SET_ORBIT"), ({"drag": 1.0}, "orbit of SAT"), ({"altitude_km": -9e9}, "orbit of SAT")],
)
def test_a_command_of_another_dictionary_is_skipped(database, clock, monkeypatch, more, source):
    """If the arguments of the last SET_ORBIT do not fit the dictionary, the next source gives the position."""
    dictionary = load_dictionary()
    operations = default_roles(dictionary).operations
    orbit = {"raan_deg": 84.0, "inclination_deg": 97.8, "latitude_deg": 30.0, "altitude_km": 600.0, "epoch_s": 100.0}
    with database.unit_of_work() as session:
        session.add(
            Command(
                name=operations.command(Operation.SET_ORBIT),
                request_id=1,
                created=clock(),
                user="kim",
                source="operator",
                result="completed",
                detail="",
                arguments=orbit | more,
                values={},
                late=False,
                attempts=1,
                resolved_note="",
            )
        )
    monkeypatch.setattr(place_of, "icrs_km", lambda trajectory, moment: np.array([7000.0, 0.0, 0.0]))
    correlation = SimpleNamespace(device_of=lambda utc_s: 200.0)
    service = PlaceService(operations, database, None, lambda: correlation, lambda moment: ("SAT", None))
    assert service.at(clock()).source == source


def test_an_element_set_far_from_its_epoch_has_no_position():
    """For a decayed orbit, no position is returned but an error is raised."""
    with pytest.raises(BadInput):
        tle_km(
            checked(TLE.replace(".00010000", ".90000000")), datetime(2026, 11, 21, tzinfo=UTC) + timedelta(days=4000)
        )
