"""Orbit files: TLE, OMM in three forms and OEM, compared with astropy's frames; and invalid files."""

import json
import re
from datetime import UTC, datetime, timedelta

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import GCRS, TEME, CartesianRepresentation
from astropy.time import Time

from gss.domain.errors import BadInput
from gss.orbit.oem import oem_of
from gss.orbit.omm import omm_of_tle
from gss.orbit.passes import find_passes
from gss.orbit.read_orbit import orbit_covering, read_orbit, stored_orbit
from gss.orbit.station import GroundStation
from gss.orbit.trajectory import TleTrajectory, fixed_from_teme, icrs_km

TLE = """ISS (ZARYA)
1 25544U 98067A   19343.69339541  .00001764  00000-0  38792-4 0  9991
2 25544  51.6439 211.2001 0007417  17.6667  85.6398 15.50103472202482
"""
START = datetime(2019, 12, 10, tzinfo=UTC)
FIELDS = omm_of_tle("ISS (ZARYA)", TLE)
KVN = "CCSDS_OMM_VERS = 2.0\nCOMMENT made here\n" + "\n".join(f"{k} = {v}" for k, v in FIELDS.items())
XML = (
    "<ndm><omm><body><segment><metadata>"
    + "".join(f"<{k}>{v}</{k}>" for k, v in list(FIELDS.items())[:6])
    + "</metadata><data><meanElements>"
    + "".join(f"<{k}>{v}</{k}>" for k, v in list(FIELDS.items())[6:13])
    + "</meanElements><tleParameters>"
    + "".join(f"<{k}>{v}</{k}>" for k, v in list(FIELDS.items())[13:])
    + "</tleParameters></data></segment></body></omm></ndm>"
)


@pytest.mark.parametrize(
    "text", [json.dumps(FIELDS), json.dumps([FIELDS]), KVN, XML], ids=["json", "list", "kvn", "xml"]
)
def test_an_omm_has_the_orbit_of_its_tle(text: str) -> None:
    """Each form of OMM gives the name of the TLE and the same positions over ten days within 30 m."""
    read, expected = read_orbit(text), TleTrajectory.of(TLE)
    times_s = START.timestamp() + np.arange(0, 864_000, 600.0)
    assert (read.kind, read.name) == ("tle", "ISS (ZARYA)")
    assert np.abs(read.orbit.teme_km(times_s) - expected.teme_km(times_s)).max() < 0.03
    assert stored_orbit(read.kind, read.text).epoch == read.orbit.epoch


@pytest.mark.parametrize("frame", ["TEME", "ICRF", "ITRF2020"])
def test_an_oem_restores_the_sampled_orbit(frame: str) -> None:
    """Positions interpolated between states every two minutes agree within 20 m in every frame. Times outside the file
    are rejected.
    """
    orbit = TleTrajectory.of(TLE)
    lines = list(oem_of("ISS", orbit, START, START + timedelta(hours=6), 120.0, START))
    if frame != "ICRF":
        times_s = START.timestamp() + np.arange(0, 21_601, 120.0)
        positions_km = orbit.teme_km(times_s)
        positions_km = fixed_from_teme(positions_km, times_s) if frame.startswith("ITRF") else positions_km
        head = "".join(lines[:4]).replace("REF_FRAME = ICRF", f"REF_FRAME = {frame}")
        states = [
            f"{datetime.fromtimestamp(t, UTC):%Y-%m-%dT%H:%M:%S} {x:.6f} {y:.6f} {z:.6f} 0 0 0\n"
            for t, (x, y, z) in zip(times_s, positions_km, strict=True)
        ]
        lines = [head, *states]
    read = read_orbit("".join(lines))
    between_s = START.timestamp() + np.arange(600, 20_000, 77.0)
    assert (read.kind, read.source_format, read.name) == ("oem", "OEM KVN", "ISS")
    assert np.abs(read.orbit.teme_km(between_s) - orbit.teme_km(between_s)).max() < 0.02
    with pytest.raises(BadInput, match="outside the validity"):
        read.orbit.teme_km(np.array([START.timestamp() - 1]))


def oem_with_segments(*spans_min: tuple[float, float], step_s: float = 60.0) -> str:
    """Return an OEM with one segment for each span, in minutes after ``START``."""
    orbit = TleTrajectory.of(TLE)
    parts = [
        list(oem_of("ISS", orbit, START + timedelta(minutes=a), START + timedelta(minutes=b), step_s, START))
        for a, b in spans_min
    ]
    return parts[0][0] + "".join(line for part in parts for line in part[1:])


def test_an_oem_is_not_interpolated_between_its_segments() -> None:
    """In a gap between two segments there is no position, no pass and no valid orbit. The export has the same segments."""
    read, expected = read_orbit(oem_with_segments((0, 60), (1440, 1500))), TleTrajectory.of(TLE)
    in_gap = START + timedelta(hours=12)
    with pytest.raises(BadInput, match="in a gap of the ephemeris"):
        read.orbit.teme_km(np.array([START.timestamp() + 60, in_gap.timestamp()]))
    assert orbit_covering([read.orbit], in_gap) is None
    assert orbit_covering([read.orbit], START + timedelta(minutes=1470)) is read.orbit
    station, end = GroundStation("roof", -0.6, 0.3, 100.0), START + timedelta(minutes=1500)
    passes, all_passes = (find_passes(orbit, station, START, end) for orbit in (read.orbit, expected))
    assert 0 < len(passes) < len(all_passes)
    for found in passes:
        assert min(abs(found.culmination - p.culmination) for p in all_passes) < timedelta(seconds=1)
    exported = "".join(oem_of("ISS", read.orbit, START, end, 60.0, START))
    assert exported.count("META_START") == 2
    assert read_orbit(exported).orbit.end == end - timedelta(seconds=60 - 1)


def test_segments_can_share_the_time_of_their_boundary() -> None:
    """Two segments with the same time at their boundary are one time span."""
    read, expected = read_orbit(oem_with_segments((0, 60), (60, 120))), TleTrajectory.of(TLE)
    assert read.orbit.spans == ((START.timestamp(), START.timestamp() + 7200),)
    times_s = START.timestamp() + np.arange(0, 7201, 50.0)
    assert np.abs(read.orbit.teme_km(times_s) - expected.teme_km(times_s)).max() < 0.02


def test_states_that_are_too_far_apart_are_rejected() -> None:
    """Steps of 8 min in low orbit give an error below 1 km. Larger steps, also of a revolution, and segments of two states are
    rejected."""
    read, expected = read_orbit(oem_with_segments((0, 600), step_s=480.0)), TleTrajectory.of(TLE)
    times_s = START.timestamp() + np.arange(0, 35_521, 50.0)
    assert np.linalg.norm(read.orbit.teme_km(times_s) - expected.teme_km(times_s), axis=1).max() < 1.0
    revolution = oem_with_segments((0, 2880), step_s=5574.0)
    for text in (oem_with_segments((0, 600), step_s=600.0), revolution, oem_with_segments((0, 60), (60, 61))):
        with pytest.raises(BadInput, match="too far apart"):
            read_orbit(text)


def test_stated_hermite_interpolation_permits_larger_steps() -> None:
    """With velocities and INTERPOLATION = HERMITE, steps of 10 and 18 min in low orbit give errors below 10 m and 1 km.
    Velocities that do not agree with the positions, or in rotating axes, are ignored.
    """
    expected, times_s = TleTrajectory.of(TLE), START.timestamp() + np.arange(1, 34_000, 50.0)
    for step_s, error_km in ((600.0, 0.01), (1080.0, 1.0)):
        stated = "REF_FRAME = ICRF\nINTERPOLATION = HERMITE\nINTERPOLATION_DEGREE = 7"
        text = oem_with_segments((0, 600), step_s=step_s).replace("REF_FRAME = ICRF", stated)
        difference_km = read_orbit(text).orbit.teme_km(times_s) - expected.teme_km(times_s)
        assert np.linalg.norm(difference_km, axis=1).max() < error_km
    for wrong in (text.replace("= ICRF", "= ITRF"), re.sub(r"( \S+){3}\n", " 0 0 0\n", text)):
        with pytest.raises(BadInput, match="too far apart"):
            read_orbit(wrong)


def test_an_exported_time_is_the_time_of_its_position() -> None:
    """An export that starts at a fraction of a millisecond agrees with the orbit within 1 m."""
    orbit, start = TleTrajectory.of(TLE), START + timedelta(microseconds=999)
    read = read_orbit("".join(oem_of("ISS", orbit, start, start + timedelta(hours=2), 60.0, start)))
    times_s = START.timestamp() + np.arange(60, 7000, 77.0)
    assert np.abs(read.orbit.teme_km(times_s) - orbit.teme_km(times_s)).max() < 1e-3


def test_the_position_agrees_with_astropy() -> None:
    """The position in celestial axes agrees with astropy within 50 m."""
    orbit, time_utc = TleTrajectory.of(TLE), START + timedelta(hours=5)
    time = Time(time_utc)
    position_km = orbit.teme_km(np.array([time_utc.timestamp()]))[0]
    expected = TEME(CartesianRepresentation(position_km * u.km), obstime=time).transform_to(GCRS(obstime=time))
    assert np.abs(icrs_km(orbit, time_utc) - expected.cartesian.xyz.to_value(u.km)).max() < 0.05


STATE = "2019-12-10T00:00:00 7000 0 0 0 7 0\n"
HEAD = "".join(list(oem_of("X", TleTrajectory.of(TLE), START, START, 60.0, START))[:4])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (TLE.replace("9991", "9992"), "wrong checksum"),
        ("", "not a two-line element set"),
        ("hello", "not a two-line element set"),
        (TLE.replace("2 25544", "2 25545"), "checksum"),
        ("{", "not valid JSON"),
        ("[]", "several objects"),
        ("[[]]", "not an OMM"),
        ("{" * 5000, "not valid JSON"),
        (json.dumps({**FIELDS, "ECCENTRICITY": "nan"}), "ECCENTRICITY"),
        (json.dumps({**FIELDS, "REF_FRAME": "ICRF"}), "REF_FRAME"),
        (json.dumps({**FIELDS, "EPOCH": "yesterday"}), "a time of the file"),
        (json.dumps({**FIELDS, "NORAD_CAT_ID": 999_999_999}), "NORAD_CAT_ID"),
        (json.dumps({**FIELDS, "NORAD_CAT_ID": "9" * 5000}), "NORAD_CAT_ID"),
        (json.dumps({**FIELDS, "EPOCH": "2060-01-01T00:00:00"}), "EPOCH"),
        (json.dumps({**FIELDS, "EPOCH": "1950-01-01T00:00:00"}), "EPOCH"),
        (json.dumps({**FIELDS, "MEAN_MOTION": -3}), "orbit|TLE"),
        (json.dumps({**FIELDS, "ECCENTRICITY": 7}), "orbit|TLE"),
        (json.dumps({k: v for k, v in FIELDS.items() if k != "INCLINATION"}), "INCLINATION"),
        ("CCSDS_OMM_VERS = 2.0\nnonsense", "line 2"),
        ("<a>", "cannot be read"),
        ("<!DOCTYPE a [<!ENTITY b 'c'>]><a>&b;</a>", "declarations"),
        ("<a/>", "one satellite"),
        (HEAD + STATE, "number of states"),
        (HEAD + STATE * 5, "in order of time"),
        (HEAD + "x y z\n", "is not a state"),
        (HEAD.replace("= UTC", "= TT") + STATE.replace("2019-12-10", "0001-01-01"), "time in line"),
        (HEAD.replace("EARTH", "MARS"), "CENTER_NAME"),
        (HEAD.replace("= ICRF", "= LVLH"), "REF_FRAME"),
        (HEAD.replace("= UTC", "= MET"), "TIME_SYSTEM"),
        ("CCSDS_OEM_VERS = 2.0\n7 7 7", "META block"),
        ("x" * 900_001, "too large"),
    ],
)
def test_an_invalid_file_is_rejected_with_its_reason(text: str, message: str) -> None:
    """Each fault raises BadInput with the reason."""
    with pytest.raises(BadInput, match=message):
        read_orbit(text)
