"""Simulated third-party units: clean-room models written from public facts, registered in the entry point group
``gss.simulators``.

They use the same line, clock, motion and faults as the simulator of the shared protocol, but not its flash and
firmware.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import entry_points
from typing import Protocol, cast

import numpy as np

from gss.device.simulator.environment import Environment
from gss.domain.angles import Array
from gss.domain.errors import BadInput, NotFound
from gss.domain.rotation import quaternion_from_matrix, rotation_from_vector
from gss.instruments.package import Instrument

SIMULATORS = "gss.simulators"
ARCSEC_RAD = float(np.radians(1 / 3600))


class SimulatedUnit(Protocol):
    """A simulated unit on a line. Inputs: bytes and simulated seconds; output: frames."""

    def feed(self, data: bytes, now_s: float) -> None: ...

    def advance(self, now_s: float) -> None: ...

    def next_frame(self, now_s: float) -> bytes | None: ...

    def shut_down(self, now_s: float) -> None: ...


@dataclass(frozen=True)
class UnitWorld:
    """Parameters of a simulated unit. ``dialects``: documented deviations to reproduce; the unit must support them."""

    instrument: Instrument
    environment: Environment
    seed: int
    dialects: frozenset[str]


def make_unit(program: str, instrument: Instrument, world: Environment, arguments: argparse.Namespace) -> SimulatedUnit:
    """Create the simulated unit of an entry point. Raises NotFound, and BadInput for an unknown dialect."""
    installed = entry_points(group=SIMULATORS)
    if program not in installed.names:
        raise NotFound("unknown simulator", expected=" | ".join(sorted(installed.names)), got=program)
    factory = cast(Callable[[UnitWorld], SimulatedUnit], installed[program].load())
    return factory(UnitWorld(instrument, world, arguments.seed, frozenset(arguments.dialect)))


def check_dialects(chosen: frozenset[str], supported: tuple[str, ...]) -> None:
    """Raise BadInput if the unit does not support a dialect."""
    for name in sorted(chosen - set(supported)):
        raise BadInput("this unit has no such dialect", expected=" | ".join(supported), got=name)


def measured(world: UnitWorld, now_s: float, sigma_arcsec: tuple[float, float, float]) -> tuple[Array, Array]:
    """Return the (4,) quaternion cam_from_icrs, scalar-last, with noise about the camera's axes, and the (3,) rate in
    rad/s. The noise depends only on seed and time."""
    pose = world.environment.motion.at(now_s)
    rng = np.random.default_rng(np.random.SeedSequence([world.seed, int(now_s * 1e3)]))
    noise_rad = rng.normal(size=3) * np.array(sigma_arcsec) * ARCSEC_RAD
    return quaternion_from_matrix(rotation_from_vector(noise_rad) @ pose.cam_from_icrs), pose.rate_rad_s
