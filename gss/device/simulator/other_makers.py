"""Simulated units of other makers: each a clean-room model made from public facts, found through ``gss.simulators``.

They share line, clock, motion and faults with the simulator of the shared protocol, and have none of its flash or firmware.
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
    """A unit on a line: bytes and simulated seconds in, frames out."""

    def feed(self, data: bytes, now_s: float) -> None: ...

    def advance(self, now_s: float) -> None: ...

    def next_frame(self, now_s: float) -> bytes | None: ...

    def shut_down(self, now_s: float) -> None: ...


@dataclass(frozen=True)
class UnitWorld:
    """What a unit is built from. ``dialects``: documented deviations to copy, of those that the unit knows."""

    instrument: Instrument
    environment: Environment
    seed: int
    dialects: frozenset[str]


def make_unit(program: str, instrument: Instrument, world: Environment, arguments: argparse.Namespace) -> SimulatedUnit:
    """Return the simulated unit of an entry point. Raises NotFound, and BadInput for an unknown dialect."""
    installed = entry_points(group=SIMULATORS)
    if program not in installed.names:
        raise NotFound("unknown simulator", expected=" | ".join(sorted(installed.names)), got=program)
    factory = cast(Callable[[UnitWorld], SimulatedUnit], installed[program].load())
    return factory(UnitWorld(instrument, world, arguments.seed, frozenset(arguments.dialect)))


def check_dialects(chosen: frozenset[str], supported: tuple[str, ...]) -> None:
    """Raise BadInput if a dialect is unknown to the unit."""
    for name in sorted(chosen - set(supported)):
        raise BadInput("this unit has no such dialect", expected=" | ".join(supported), got=name)


def measured(world: UnitWorld, now_s: float, sigma_arcsec: tuple[float, float, float]) -> tuple[Array, Array]:
    """Return the (4,) quaternion cam_from_icrs, scalar-last, with noise about the camera's axes, and the (3,) rate in rad/s.
    The noise depends on seed and time only."""
    pose = world.environment.motion.at(now_s)
    rng = np.random.default_rng(np.random.SeedSequence([world.seed, int(now_s * 1e3)]))
    noise_rad = rng.normal(size=3) * np.array(sigma_arcsec) * ARCSEC_RAD
    return quaternion_from_matrix(rotation_from_vector(noise_rad) @ pose.cam_from_icrs), pose.rate_rad_s
