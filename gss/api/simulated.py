"""Start the simulated sensor of a server process or unit process."""

from __future__ import annotations

import shlex
from contextlib import AbstractContextManager

from gss.instruments.registry import Registry
from gss.operations.line.simulated_sensor import SimulatedSensor, simulated_sensor
from gss.settings import Settings


def start_simulator(settings: Settings) -> AbstractContextManager[SimulatedSensor]:
    """Start the simulated sensor that the settings describe. It stops at the end of the ``with`` block."""
    options = settings.simulator_options
    if settings.link_keys:
        options += f" --keys {shlex.quote(settings.link_keys)}"
    package = Registry(settings.instruments_folder).folder(settings.simulator)
    folder, baud, seed = settings.data / "simulator", settings.simulator_baud, settings.simulator_seed
    return simulated_sensor(package, folder, baud, seed, settings.framing, options)
