"""The simulator's program: one simulated star tracker on a pseudo-terminal, a TCP port or a CAN bus.

Prints the line ``READY <url>`` when the link can be opened. With ``--stepped`` it also prints the answers to time
commands. Ends on SIGTERM or SIGINT and, if requested, when standard input closes.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import signal
import sys
from collections.abc import Sequence

from gss import garbage
from gss.device.line_address import CAN
from gss.device.link_keys import read_link_keys
from gss.device.simulator.can_line import CanBusLine, bus_port
from gss.device.simulator.factory import burn_golden
from gss.device.simulator.firmware import StarTracker
from gss.device.simulator.machine import Identity, SimulatedDevice
from gss.device.simulator.memory import GOLDEN, Memory
from gss.device.simulator.options import add_arguments, instrument_of, make_environment
from gss.device.simulator.other_makers import SimulatedUnit, check_dialects, make_unit
from gss.device.simulator.own_lens import own_lens
from gss.device.simulator.power import Power
from gss.device.simulator.rejection import Rejection
from gss.device.simulator.simulated_time import SimulatedClock, TimeControl
from gss.device.simulator.sky import SimulatedSky
from gss.device.simulator.terminal import DeviceLine, PtyLine, TcpLine, Terminal
from gss.domain.errors import BadInput, GssError
from gss.instruments.golden import build_golden
from gss.instruments.package_files import SimulatorFile

IDLE_S = 0.01
BUSY_S = 0.001


def make_line(arguments: argparse.Namespace) -> DeviceLine:
    """Open the line: a CAN bus for an instrument on CAN, otherwise a TCP port or a pseudo-terminal. Raises BadInput or
    Conflict."""
    on_can = instrument_of(arguments).link.framing == CAN
    if (arguments.tcp if on_can else arguments.can) is not None:
        raise BadInput(
            "the instrument uses another type of line",
            expected="--can" if on_can else "--tcp or --pty",
            got=arguments.instrument,
        )
    if on_can:
        return CanBusLine(bus_port(arguments.can or 0, arguments.state_dir))
    return TcpLine(arguments.tcp) if arguments.tcp is not None else PtyLine(arguments.symlink)


def make_terminal(arguments: argparse.Namespace, line: DeviceLine) -> tuple[Terminal, SimulatedUnit, SimulatedClock]:
    """Create the simulated unit, its terminal and its clock."""
    instrument = instrument_of(arguments)
    camera, link, behaviour = instrument.profile, instrument.link, instrument.simulator or SimulatorFile()
    clock = SimulatedClock(arguments.speed, stopped=arguments.stepped)
    began_s = clock()
    if behaviour.program:
        world = make_environment(arguments, camera, instrument, clock.utc_zero_s())
        unit = make_unit(behaviour.program, instrument, world, arguments)
        rate = (link.baud if arguments.baud is None else arguments.baud) / 10
        return Terminal(line, unit, clock, rate, world.line), unit, clock
    check_dialects(frozenset(arguments.dialect), ())
    if instrument.catalogue is None:
        raise BadInput("an instrument without catalogue.yaml cannot be simulated", got=instrument.name)
    baud = link.baud if arguments.baud is None else arguments.baud
    bank_bytes = instrument.catalogue.bank_bytes
    in_files = arguments.state_dir is not None
    memory = Memory.in_directory(arguments.state_dir, bank_bytes) if in_files else Memory.in_ram(bank_bytes)
    golden = memory.record.banks[GOLDEN]
    if golden.profile != camera.name or not memory.intact(GOLDEN):
        burn_golden(memory, camera, build_golden(camera, memory.bank_bytes))
    real = own_lens(camera, arguments.lens_off, arguments.seed)
    world = make_environment(arguments, real, instrument, clock.utc_zero_s() + began_s - memory.record.time_base_s)
    colours = arguments.star_colours or behaviour.star_colours
    sky = SimulatedSky(real, world.motion, world.epoch_jyear, arguments.seed, world, star_colours=colours)
    serial = f"SIM-{arguments.seed:04d}"
    identity = Identity(serial=serial, line_baud=baud)
    tracker = StarTracker(camera, sky, memory, behaviour.timing)
    with contextlib.suppress(Rejection):  # the device reports an unusable bank when it uses the bank
        tracker.warm()
    rate_hz = arguments.housekeeping_hz
    timing = behaviour.timing
    if rate_hz is not None:
        timing = timing.model_copy(update={"housekeeping_s": 1.0 / min(1000.0, max(0.001, rate_hz))})
    framing = arguments.framing or link.framing
    device = SimulatedDevice(
        instrument.dictionary,
        identity,
        memory,
        tracker,
        began_s,
        framing=framing,
        timing=timing,
        power=Power(behaviour.power),
        keys=read_link_keys(arguments.keys) if arguments.keys else None,
    )
    return Terminal(line, device, clock, baud / 10, world.line), device, clock


def serve(
    terminal: Terminal,
    device: SimulatedUnit,
    clock: SimulatedClock,
    url: str,
    *,
    watch_stdin: bool,
    paced: bool = False,
) -> None:
    """Run until stopped. If ``watch_stdin``, time commands are read from standard input. ``paced``: limit the line to
    its rate also while the clock is stopped."""
    stopping = False

    def stop(*_: object) -> None:
        nonlocal stopping
        stopping = True

    signal.signal(signal.SIGTERM, stop)
    signal.signal(signal.SIGINT, stop)
    _say(f"READY {url}")
    time_control = TimeControl(clock, terminal, lambda: stopping)
    terminal.paced = paced or not clock.stopped
    handles = [sys.stdin.fileno()] if watch_stdin else []
    try:
        while not stopping:
            ready = terminal.run_once(BUSY_S if terminal.busy else IDLE_S, handles)
            if ready:
                data = os.read(ready[0], 4096)
                stopping = stopping or not data
                for answer in time_control.feed(data):
                    _say(answer)
    finally:
        device.shut_down(clock())
        terminal.close()


def _say(line: str) -> None:
    sys.stdout.write(f"{line}\n")
    sys.stdout.flush()


def main(argv: Sequence[str] | None = None) -> int:
    """Parse the options, create the device and run it. Returns the exit code."""
    parser = argparse.ArgumentParser(prog="gss.device.simulator", description="Simulate a star tracker on a line.")
    add_arguments(parser)
    arguments = parser.parse_args(argv)
    line: DeviceLine | None = None
    try:
        line = make_line(arguments)
        terminal, device, clock = make_terminal(arguments, line)
    except GssError as error:
        if line is not None:
            line.close()
        return _failed(error)
    garbage.collect_as_usual()
    try:
        serve(
            terminal,
            device,
            clock,
            line.url,
            watch_stdin=arguments.exit_with_stdin or arguments.stepped,
            paced=arguments.paced,
        )
    except GssError as error:  # for example, the satellite has decayed
        return _failed(error)
    return 0


def _failed(error: GssError) -> int:
    """Print the error. Returns the exit code."""
    sys.stderr.write(f"simulator: {error.sentences()}\n")
    return 2
