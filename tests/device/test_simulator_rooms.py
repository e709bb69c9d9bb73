"""Flash, motion, sky and line faults of the simulator, each compared with its specification."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gss.device.simulator.faults import FaultRates, LineFaults
from gss.device.simulator.firmware import StarTracker
from gss.device.simulator.machine import Identity, SimulatedDevice
from gss.device.simulator.memory import BankRecord, Flash, FlashError, Memory, StoredRequest, SuspendedUpload
from gss.device.simulator.orbit import EARTH_RADIUS_KM, Inertial, Motion, Zenith
from gss.device.simulator.sky import SimulatedSky
from gss.domain.frames import ra_dec_roll_rad
from gss.instruments.dictionary.read_dictionary import load_dictionary
from gss.instruments.registry import shipped_camera


def test_flash_bits_are_only_cleared_until_erased() -> None:
    """Programming the same data again succeeds, and other data over it fails. An erase clears a complete sector."""
    flash = Flash(bytearray(b"\xff" * 3 * 4096))
    flash.program(4090, b"\x0f\xf0abcdefgh")
    flash.program(4090, b"\x0f\xf0abcdefgh")
    with pytest.raises(FlashError):
        flash.program(4091, b"\xff")
    flash.erase(4096, 1)
    assert flash.read(4090, 10) == b"\x0f\xf0abcd" + b"\xff" * 4


def test_state_survives_a_restart(tmp_path: Path) -> None:
    """Flash and record are restored exactly from the directory, including a suspended upload."""
    memory = Memory.in_directory(tmp_path)
    memory.burn("A", b"catalogue", BankRecord(stars=3, profile="cubestar", epoch_jyear=2025.5))
    memory.record.uploads["B"] = SuspendedUpload(1000, 100, "ab" * 32, ((0, 3), (5, 5)))
    memory.remember(StoredRequest(7, 33, "cd", "0500"))
    memory.activate("A")
    memory.save()
    restored = Memory.in_directory(tmp_path)
    assert asdict(restored.record) == asdict(memory.record)
    assert restored.content("A") == b"catalogue"
    assert restored.intact("A")
    restored.flash.flip(restored.offset("A"))
    assert not restored.intact("A")


@pytest.mark.parametrize(
    "motion",
    [Zenith(), Zenith(raan_rad=1.0, start_rad=2.0), Inertial.pointing(1.0, -0.4, 2.0, (0.001, -0.002, 0.0005))],
)
def test_rate_is_the_derivative_of_attitude(motion: Motion) -> None:
    """The rate passed to the renderer equals the numerical derivative of the attitude, calculated with scipy."""
    for time_s in (0.0, 1234.5):
        before, after = motion.at(time_s - 0.5), motion.at(time_s + 0.5)
        change = Rotation.from_matrix(after.cam_from_icrs @ before.cam_from_icrs.T).as_rotvec()
        assert change == pytest.approx(-motion.at(time_s).rate_rad_s, abs=1e-6)
        assert np.linalg.det(before.cam_from_icrs) == pytest.approx(1.0)


def test_the_zenith_camera_rotates_once_per_orbit() -> None:
    """At 600 km the zenith camera rotates once in 96.7 minutes along a great circle with the orbit's inclination."""
    motion = Zenith()
    period_s = 2 * np.pi / motion.mean_motion_rad_s
    assert period_s / 60 == pytest.approx(96.7, abs=0.1)
    assert motion.altitude_km + EARTH_RADIUS_KM == pytest.approx(6978, abs=1)
    assert np.allclose(motion.at(0).cam_from_icrs, motion.at(period_s).cam_from_icrs)
    declinations = [ra_dec_roll_rad(motion.at(t).cam_from_icrs)[1] for t in np.linspace(0, period_s, 400)]
    assert np.degrees(max(declinations)) == pytest.approx(180 - 97.8, abs=0.1)


def test_seed_and_number_determine_an_image() -> None:
    """The same seed and frame number give the same image, and another number gives another one."""
    camera = shipped_camera("cubestar")
    skies = [SimulatedSky(camera, Zenith(), 2026.0, 5) for _ in range(2)]
    first, second = (sky.expose(10.0, 0.25, 3).pixels for sky in skies)
    assert np.array_equal(first, second)
    assert not np.array_equal(first, skies[0].expose(10.0, 0.25, 4).pixels)


def test_bit_errors_have_the_configured_rate() -> None:
    """At a bit error rate of 1e-3, about 1000 of a million bits are flipped, and none at rate zero."""
    data = bytes(125_000)
    damaged = LineFaults(FaultRates(bit_error_rate=1e-3), 3).apply(data)
    flipped = int(np.unpackbits(np.frombuffer(damaged, np.uint8)).sum())
    assert 900 < flipped < 1100
    assert LineFaults(FaultRates(), 3).apply(data) == data


def test_drops_and_duplicates_affect_blocks() -> None:
    """At a rate of 0.1, about 10 % of the blocks of 64 bytes are lost, or arrive twice."""
    data = bytes(64 * 1000)
    assert 64 * 850 < len(LineFaults(FaultRates(drop_rate=0.1), 3).apply(data)) < 64 * 950
    assert 64 * 1050 < len(LineFaults(FaultRates(duplicate_rate=0.1), 3).apply(data)) < 64 * 1150


def test_stalls_last_their_time() -> None:
    """With these rates the line is stalled between 20 % and 50 % of the time."""
    faults = LineFaults(FaultRates(stall_rate=1.0, stall_s=0.5), 4)
    states = [faults.stalled(t) for t in np.arange(0, 60, 0.01)]
    assert 0.2 < np.mean(states) < 0.5


def test_every_command_of_the_dictionary_has_a_handler() -> None:
    """The simulated device has a handler for every command of the dictionary, and no others."""
    camera = shipped_camera("cubestar")
    memory = Memory.in_ram()
    tracker = StarTracker(camera, SimulatedSky(camera, Zenith(), 2026.0, 1), memory)
    device = SimulatedDevice(load_dictionary(), Identity(), memory, tracker, 0.0)
    assert set(device._processor.handlers) == {c.name for c in load_dictionary().commands}
