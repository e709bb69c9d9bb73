"""CCSDS attitude messages: the convention of the standard, reading, writing, and invalid files."""

from __future__ import annotations

from datetime import UTC, datetime

import numpy as np
import pytest

from gss.domain.errors import BadInput
from gss.domain.frames import cam_from_icrs
from gss.domain.rotation import matrix_from_quaternion, quaternion_from_matrix, turn_between
from gss.orbit.attitude import AttitudeHistory
from gss.orbit.read_attitude import read_attitude
from gss.orbit.write_attitude import acm_of, aem_of

START_S = datetime(2026, 12, 1, 18, tzinfo=UTC).timestamp()
CREATED = datetime(2026, 12, 2, tzinfo=UTC)
ATTITUDES = [cam_from_icrs(*np.radians([80.0 + k, -30.0, 10.0 + 2 * k])) for k in range(5)]
HISTORY = AttitudeHistory(
    "ZA-1",
    "STARTRACKER_1",
    START_S + 0.25 + 10.0 * np.arange(5),
    np.array([quaternion_from_matrix(m) for m in ATTITUDES]),
    np.array([[1e-5, 1e-5, 8e-5]] * 4 + [[np.nan] * 3]),
)
AEM, ACM = "".join(aem_of(HISTORY, CREATED)), "".join(acm_of(HISTORY, "DETERMINED_GND", CREATED))


def standards_matrix(q1: float, q2: float, q3: float, qc: float) -> np.ndarray:
    """Return the matrix from A to B of a quaternion, written out as in CCSDS 504.0-B."""
    return np.array(
        [
            [q1**2 - q2**2 - q3**2 + qc**2, 2 * (q1 * q2 + q3 * qc), 2 * (q1 * q3 - q2 * qc)],
            [2 * (q1 * q2 - q3 * qc), -(q1**2) + q2**2 - q3**2 + qc**2, 2 * (q2 * q3 + q1 * qc)],
            [2 * (q1 * q3 + q2 * qc), 2 * (q2 * q3 - q1 * qc), -(q1**2) - q2**2 + q3**2 + qc**2],
        ]
    )


def test_an_aem_follows_the_convention_of_the_standard() -> None:
    """Each line of an AEM, converted with the standard's matrix, is the rotation from ICRF to the camera."""
    head, _, data = AEM.partition("DATA_START\n")
    assert "REF_FRAME_A = ICRF\nREF_FRAME_B = STARTRACKER_1\nATTITUDE_DIR = A2B\nTIME_SYSTEM = UTC\n" in head
    assert "START_TIME = 2026-12-01T18:00:00.250000\nSTOP_TIME = 2026-12-01T18:00:40.250000\n" in head
    lines = data.splitlines()[:-1]
    for line, attitude in zip(lines, ATTITUDES, strict=True):
        assert np.allclose(standards_matrix(*map(float, line.split()[1:])), attitude, atol=1e-11)


def test_an_acm_states_variances_in_square_degrees() -> None:
    """Attitudes with a known uncertainty have variances about the frame's axes, in square degrees."""
    block = ACM.split("COV_TYPE = ANGLE\n")[1].splitlines()[:-1]
    variances = np.array([line.split()[1:] for line in block], float)
    assert np.allclose(np.radians(np.sqrt(variances)), HISTORY.sigma_rad[:4], rtol=1e-5)


def rewritten(old: str, new: str) -> str:
    """Return the AEM with a part replaced."""
    assert old in AEM
    return AEM.replace(old, new)


SCALAR_FIRST = rewritten("QUATERNION_TYPE = LAST", "QUATERNION_TYPE = FIRST")
VERSION_2 = rewritten("AEM_VERS = 1.0", "AEM_VERS = 2.0").replace("ATTITUDE_DIR = A2B\nTIME", "TIME")
VERSION_2 = VERSION_2.replace("QUATERNION_TYPE = LAST\n", "").replace("DATA_START\n", "").replace("DATA_STOP\n", "")
IN_TAI = rewritten("TIME_SYSTEM = UTC", "TIME_SYSTEM = TAI")


@pytest.mark.parametrize("text", [AEM, ACM, VERSION_2], ids=["aem", "acm", "version 2"])
def test_a_message_is_read_back(text: str) -> None:
    """A written message is read back with times accurate to 2 µs and attitudes to a thousandth of an arcsecond."""
    read = read_attitude(text)
    assert (read.object_name, read.frame) == ("ZA-1", "STARTRACKER_1")
    assert np.abs(read.times_s - HISTORY.times_s).max() < 2e-6
    assert np.abs(turn_between(HISTORY.quaternions, read.quaternions)).max() < 5e-9


def test_directions_orders_and_time_scales_of_other_writers_are_read() -> None:
    """Messages with direction A to B or B to A, with the scalar first, and with International Atomic Time are read."""
    swapped = rewritten(
        "REF_FRAME_A = ICRF\nREF_FRAME_B = STARTRACKER_1", "REF_FRAME_A = SC_BODY_1\nREF_FRAME_B = ICRF"
    )
    reversed_direction = rewritten("= A2B", "= B2A")
    for text in (swapped, reversed_direction):
        read = read_attitude(text)
        for quaternion, attitude in zip(read.quaternions, ATTITUDES, strict=True):
            assert np.allclose(matrix_from_quaternion(quaternion), attitude.T, atol=1e-11)
    assert read_attitude(swapped).frame == "SC_BODY_1"
    lines = SCALAR_FIRST.split("\n")
    scalar_first = [
        " ".join([p[0], p[4], *p[1:4]]) if len(p := line.split()) == 5 and "=" not in line else line for line in lines
    ]
    assert np.allclose(read_attitude("\n".join(scalar_first)).quaternions, read_attitude(AEM).quaternions)
    assert read_attitude(IN_TAI).times_s[0] == pytest.approx(HISTORY.times_s[0] - 37)


def test_attitudes_are_interpolated_at_a_constant_rate_and_not_over_gaps() -> None:
    """Halfway between two attitudes, half of the rotation has taken place. Outside the times and in gaps there is no
    attitude, except at the times of the attitudes themselves.
    """
    halves = HISTORY.at(HISTORY.times_s[:4] + 5)
    first_half = turn_between(HISTORY.quaternions[:4], halves)
    assert np.allclose(first_half, turn_between(halves, HISTORY.quaternions[1:]), atol=1e-12)
    assert np.isnan(HISTORY.at(np.array([START_S, START_S + 60]))).all()
    sparse = AttitudeHistory("a", "b", HISTORY.times_s * 100, HISTORY.quaternions, HISTORY.sigma_rad)
    assert np.isnan(sparse.at(sparse.times_s[:1] + 500)).all()
    assert np.allclose(sparse.at(sparse.times_s), sparse.quaternions)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "not an attitude message"),
        ("CCSDS_OEM_VERS = 2.0", "not an attitude message"),
        ("CCSDS_AEM_VERS = 2.0\n", "no attitudes"),
        (rewritten("TYPE = QUATERNION\n", "TYPE = EULER_ANGLE\n"), "type of the attitudes"),
        (rewritten("= ICRF", "= ITRF2000"), "frames are not supported"),
        (rewritten("SYSTEM = UTC", "SYSTEM = TDB"), "TIME_SYSTEM"),
        (rewritten("\n2026-12-01T18:00:10", "\n2026-13-01T18:00:10"), "valid"),
        (rewritten("\n2026-12-01T18:00:10", "\n2026-12-01T17:00:10"), "order of time"),
        (AEM.replace("0.", "0.9"), "not an attitude"),
        (ACM.replace("\n40.000000 ", "\n1e15 "), "not an attitude"),
        (AEM.replace("DATA_STOP", "META_STOP"), "Line"),
        (AEM.replace("ZA-1", "ZA\x1b[2J"), "cannot be shown"),
        (AEM.replace("ZA-1", 4_000_000 * "Z"), "cannot be shown"),
        (AEM + AEM.replace("ZA-1", "ZA-2"), "several objects"),
        (AEM.partition("META_START")[0] + AEM.partition("META_STOP\n")[2], "META block"),
    ],
)
def test_an_invalid_message_is_rejected_with_the_reason(text: str, message: str) -> None:
    """An invalid message is rejected with its line or keyword."""
    with pytest.raises(BadInput, match=message):
        read_attitude(text)
