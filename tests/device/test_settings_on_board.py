"""Settings and requests: stored results, gain, period, time, memory areas, and orbit and matched vectors of Sunsat."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
import pytest
from astropy import units
from astropy.coordinates import get_body_barycentric_posvel
from astropy.time import Time

from gss.device.protocol.codec import decode
from gss.device.session_events import Stage
from gss.domain.rotation import matrix_from_quaternion
from gss.pipeline.chains.apriori import EARTH_RADIUS_M, KnownOrbit, apriori_hint
from gss.pipeline.chains.sunsat_frames import BODY_FROM_CAM, attitude_angles_rad
from tools.chain_stages import STAGES
from tools.chains_reach import recorded

if TYPE_CHECKING:
    from conftest import Bench

UTC_S = 1_790_000_000.0


@pytest.mark.parametrize(
    ("ask", "make", "packet", "count"),
    [
        ("GET_CENTROIDS", "FIND_CENTROIDS", "centroids", "count"),
        ("GET_MATCHES", "MATCH_STARS", "matches", "count"),
        ("GET_ATTITUDE", "CALCULATE_ATTITUDE", "attitude", ""),
    ],
)
def test_results_can_be_requested_again(bench: Bench, ask: str, make: str, packet: str, count: str) -> None:
    """A request for a result fails with ``no_image`` before an image is taken. Afterwards it repeats the original packet."""
    rejection = bench.do(ask)
    assert (rejection.stage, rejection.reason) == (Stage.FAILED, "no_image")
    bench.do("TAKE_IMAGE")
    for name in ("FIND_CENTROIDS", "MATCH_STARS", "CALCULATE_ATTITUDE"):
        bench.do(name)
        if name == make:
            break
    original = bench.telemetry(packet)[-1]
    answer, repeated = bench.do(ask), bench.telemetry(packet)[-1]
    assert (repeated.values, repeated.lists) == (original.values, original.lists)
    assert repeated is not original
    assert answer.values["frame_number"] == original.values["frame_number"]
    if count:
        assert answer.values[count] == len(original.lists["items"])


def test_gain_multiplies_the_signal_above_bias(bench: Bench) -> None:
    """Four times the gain gives four times the signal above bias, up to saturation; a reset restores the default."""
    bench.do("TAKE_IMAGE", slot=0)
    assert bench.do("SET_GAIN", gain=4).stage is Stage.COMPLETED
    assert bench.status()["gain"] == 4
    bench.do("TAKE_IMAGE", slot=1)
    low_gain, high_gain = (bench.tracker.slots[i].pixels.astype(float) for i in (0, 1))
    bias = bench.tracker.profile.sensor.bias_dn
    assert high_gain.max() == 255
    assert (high_gain.mean() - bias) / (low_gain.mean() - bias) == pytest.approx(4.0, rel=0.15)
    bench.do("RESET")
    bench.run(1.0)
    assert bench.status()["gain"] == 1


def test_the_period_of_the_cycle_is_the_commanded_one(bench: Bench) -> None:
    """With a commanded period of 2.5 s, frames are taken at that interval, and housekeeping has the period."""
    bench.do("SET_FRAME_RATE", period_ms=2500)
    bench.do("START_CYCLE")
    bench.run(11.0)
    times = [float(t.values["frame_time_s"]) for t in bench.telemetry("frame_info")]
    assert len(times) in (4, 5)
    assert np.diff(times) == pytest.approx(2.5, abs=0.02)
    assert bench.status()["period_ms"] == 2500


def test_the_clock_keeps_its_time_until_power_off(bench: Bench) -> None:
    """The clock is unset before SET_TIME, correct afterwards, and continues over a reset."""
    before = bench.status()
    assert before["time_set"] is False
    assert np.isnan(float(before["utc_s"]))
    bench.do("SET_TIME", utc_s=UTC_S)
    set_at_s = bench.now_s
    assert [e.name for e in bench.device_events("TIME_SET")] == ["TIME_SET"]
    bench.do("RESET")
    bench.run(5.0)
    housekeeping = bench.telemetry("housekeeping")[-1]
    assert housekeeping.values["time_set"] is True
    assert float(housekeeping.values["utc_s"]) - UTC_S == pytest.approx(bench.now_s - set_at_s, abs=1.2)


def test_memories_are_read_unchanged(bench: Bench) -> None:
    """READ_MEMORY returns flash, image memory across the boundary of two slots, and the registers, which are encoded like
    housekeeping."""
    bench.do("TAKE_IMAGE", slot=0)
    bench.do("TAKE_IMAGE", slot=1)

    def read(area: str, address: int, length: int) -> bytes:
        assert bench.do("READ_MEMORY", area=area, address=address, length=length).stage is Stage.COMPLETED
        packet = bench.telemetry("memory")[-1]
        assert (packet.values["area"], packet.values["address"]) == (area, address)
        return bytes(int(row["byte"]) for row in packet.lists["items"])

    golden_offset = bench.memory.offset("golden")
    assert read("flash", golden_offset, 240) == bench.memory.content("golden")[:240]
    size = bench.tracker.imager.frame_size
    both_slots = bench.tracker.slots[0].data + bench.tracker.slots[1].data
    assert read("sram", size - 100, 200) == both_slots[size - 100 : size + 100]
    fields = bench.dictionary.packet("housekeeping").fields
    length = len(bench.device._registers())
    registers = b"".join(
        read("registers", address_of_part, min(240, length - address_of_part))
        for address_of_part in range(0, length, 240)
    )
    assert decode(fields, registers).values["gain"] == 1


@pytest.mark.parametrize("area", ["flash", "sram", "registers"])
def test_memory_cannot_be_read_beyond_its_end(bench: Bench, area: str) -> None:
    """The last byte of each area can be read. Reading beyond it is rejected."""
    sizes = {
        "flash": len(bench.memory.flash),
        "sram": 4 * bench.tracker.imager.frame_size,
        "registers": len(bench.device._registers()),
    }
    assert bench.do("READ_MEMORY", area=area, address=sizes[area] - 1, length=1).stage is Stage.COMPLETED
    beyond = bench.do("READ_MEMORY", area=area, address=sizes[area] - 1, length=2)
    assert (beyond.stage, beyond.reason) == (Stage.FAILED, "out_of_range")
    assert bench.do("READ_MEMORY", area=area, address=4294967295, length=240).reason == "out_of_range"


def sunsat(make_bench: Callable[..., Bench]) -> tuple[Bench, KnownOrbit, tuple[float, float, float]]:
    """Return a Sunsat unit, an orbit, and the true roll, pitch and yaw of its camera relative to the orbit frame."""
    bench = make_bench(camera="sunsat")
    bench.until(lambda: bench.host.hello is not None)
    orbit = KnownOrbit(np.radians(40.0), np.radians(97.0), np.radians(10.0), 600e3, 0.0)
    now_s = bench.device.time_s
    true_attitude = bench.tracker.sky.environment.motion.at(now_s).cam_from_icrs
    return bench, orbit, attitude_angles_rad(true_attitude, orbit.elements_at(now_s))


def send_orbit_and_apriori(
    bench: Bench, orbit: KnownOrbit, angles_rad: tuple[float, float, float], off_deg: float = 0.0
) -> None:
    degrees = np.degrees(angles_rad)
    bench.do(
        "SET_ORBIT",
        raan_deg=float(np.degrees(orbit.raan_rad)),
        inclination_deg=float(np.degrees(orbit.inclination_rad)),
        latitude_deg=float(np.degrees(orbit.latitude_rad)),
        altitude_km=orbit.altitude_m / 1000,
        epoch_s=orbit.epoch_s,
    )
    roll, pitch, yaw = (float(d) for d in degrees)
    bench.do("SET_APRIORI", roll_deg=roll + off_deg, pitch_deg=pitch, yaw_deg=yaw, uncertainty_deg=3.0)


def test_the_apriori_attitude_is_the_hint_of_an_assisted_iteration(make_bench: Callable[..., Bench]) -> None:
    """Assisted mode is rejected without orbit and a-priori attitude. With both, the hint of an iteration is the a-priori
    attitude at the time of the frame."""
    bench, orbit, angles_rad = sunsat(make_bench)
    assert bench.do("SET_MODE", mode="assisted").reason == "wrong_state"
    send_orbit_and_apriori(bench, orbit, angles_rad)
    assert bench.status()["orbit_known"] is True
    assert bench.do("SET_MODE", mode="assisted").stage is Stage.COMPLETED
    assert bench.do("RUN_ITERATION", seconds=70).values["outcome"] == "solved"
    attitude, work = bench.telemetry("attitude")[-1].values, bench.tracker.work
    assert attitude["mode"] == "assisted"
    assert work is not None
    assert work.hint is not None
    commanded_rad = tuple(float(np.radians(float(np.float32(np.degrees(a))))) for a in angles_rad)
    expected = apriori_hint(orbit, commanded_rad, float(attitude["frame_time_s"]))  # type: ignore[arg-type]
    assert work.hint.boresight_icrs == pytest.approx(expected.boresight_icrs, abs=1e-9)
    bench.do("SET_APRIORI", uncertainty_deg=180.0)
    assert bench.tracker.prior.apriori is None


def test_a_wrong_apriori_attitude_gives_no_attitude(make_bench: Callable[..., Bench]) -> None:
    """With an a-priori attitude that is wrong by 20° and an uncertainty of 3°, an iteration has no result."""
    bench, orbit, angles_rad = sunsat(make_bench)
    send_orbit_and_apriori(bench, orbit, angles_rad, off_deg=20.0)
    bench.do("SET_MODE", mode="assisted")
    assert bench.do("RUN_ITERATION", seconds=70).values["outcome"] == "none"


def test_matched_vectors_are_sent_with_every_attitude_and_agree_with_astropy(make_bench: Callable[..., Bench]) -> None:
    """Matched vectors are observed directions in body axes and reference directions in orbit axes, with aberration equal
    to that of an independent ephemeris. None are sent before orbit and UTC are known."""
    bench, orbit, angles_rad = sunsat(make_bench)
    bench.do("RUN_ITERATION", seconds=70)
    send_orbit_and_apriori(bench, orbit, angles_rad)
    bench.do("RUN_ITERATION", seconds=70)
    assert bench.telemetry("matched_vectors") == []
    bench.do("SET_TIME", utc_s=UTC_S)
    bench.do("SET_FRAME_RATE", period_ms=1000)
    bench.do("START_CYCLE")
    bench.run(8.0)
    bench.do("STOP_CYCLE")
    solved = [t.values for t in bench.telemetry("attitude") if t.values["outcome"] == "solved"][2:]
    vectors = bench.telemetry("matched_vectors")
    assert len(vectors) >= 4
    assert [t.values["frame_number"] for t in vectors] == [v["frame_number"] for v in solved]
    last, attitude = vectors[-1], solved[-1]
    rows = last.lists["items"]
    body = np.array([[row[f"body_{a}"] for a in "xyz"] for row in rows], float)
    reference = np.array([[row[f"orbit_{a}"] for a in "xyz"] for row in rows], float)
    frame_time_s = float(last.values["frame_time_s"])
    elements = orbit.elements_at(frame_time_s)
    cam_from_icrs = matrix_from_quaternion(np.array([float(attitude[f"quaternion_{a}"]) for a in "xyzw"]))
    body_from_orbit = BODY_FROM_CAM @ cam_from_icrs @ elements.orbit_from_icrs.T
    assert np.abs(np.linalg.norm(body, axis=1) - 1).max() < 1e-6
    # Both sets are equal within the attitude error and up to 30″ of aberration.
    assert np.abs(body @ body_from_orbit - reference).max() < np.radians(0.02)
    catalogue = bench.tracker.catalogue
    assert catalogue is not None
    stars = np.array([int(row["star"]) for row in rows])
    icrs = catalogue.icrs[stars].astype(float)
    icrs /= np.linalg.norm(icrs, axis=1, keepdims=True)
    when = Time(UTC_S + (frame_time_s - _device_time_of(bench)), format="unix")
    earth = get_body_barycentric_posvel("earth", when)[1].xyz.to_value(units.km / units.s)
    speed_km_s = orbit.rate_rad_s * (EARTH_RADIUS_M + orbit.altitude_m) / 1000
    velocity = earth + elements.orbit_from_icrs.T @ np.array([speed_km_s, 0.0, 0.0])
    apparent = icrs + velocity / 299_792.458
    apparent /= np.linalg.norm(apparent, axis=1, keepdims=True)
    error_rad = np.linalg.norm(apparent @ elements.orbit_from_icrs.T - reference, axis=1)
    assert error_rad.max() < np.radians(0.3 / 3600)


def _device_time_of(bench: Bench) -> float:
    """Return the device time at which UTC was UTC_S."""
    offset_s = bench.memory.record.utc_offset_s
    assert offset_s is not None
    return UTC_S - offset_s


def test_the_unit_runs_the_stages_that_need_its_orbit(make_bench: Callable[..., Bench]) -> None:
    """A unit with orbit, UTC and a-priori attitude runs the stages that docs/chains.md lists for such units only."""
    bench, orbit, angles_rad = sunsat(make_bench)
    bench.do("SET_TIME", utc_s=UTC_S)
    send_orbit_and_apriori(bench, orbit, angles_rad)
    bench.do("SET_MODE", mode="assisted")
    bench.do("SET_FRAME_RATE", period_ms=1000)
    with recorded() as calls:
        bench.do("START_CYCLE")
        bench.run(8.0)
        bench.do("STOP_CYCLE")
    assert [s.where for s in STAGES["sunsat"] if s.by_unit and s.full_name not in calls] == []
