"""``python -m gss.device.simulator``: one simulated star tracker on a pseudo-terminal or a TCP port.

Prints one line ``READY <url>`` when the link can be opened. Standard output contains nothing else except, with
``--stepped``, the answers to time commands. Ends on SIGTERM or SIGINT, or when standard input closes if requested.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import signal
import sys
from collections.abc import Sequence

from gss.device.dictionary_file import load_dictionary
from gss.device.golden import build_golden
from gss.device.simulator.factory import burn_golden
from gss.device.simulator.firmware import StarTracker
from gss.device.simulator.machine import Device, Identity
from gss.device.simulator.memory import GOLDEN, Memory
from gss.device.simulator.options import add_arguments, make_environment
from gss.device.simulator.own_lens import own_lens
from gss.device.simulator.refusal import Refusal
from gss.device.simulator.simulated_time import SimulatedClock, TimeDesk
from gss.device.simulator.sky import Sky
from gss.device.simulator.terminal import Line, PtyLine, TcpLine, Terminal
from gss.domain.errors import GssError
from gss.domain.profiles import profile

IDLE_S = 0.01
BUSY_S = 0.001


def make_terminal(arguments: argparse.Namespace, line: Line) -> tuple[Terminal, Device, SimulatedClock]:
    """Return the device connected to its line."""
    camera = profile(arguments.profile)
    memory = Memory.in_directory(arguments.state_dir) if arguments.state_dir else Memory.in_ram()
    held = memory.record.banks[GOLDEN]
    if held.profile != camera.name or not memory.intact(GOLDEN):
        burn_golden(memory, camera, build_golden(camera, memory.bank_bytes))
    real = own_lens(camera, arguments.lens_off, arguments.seed)
    world = make_environment(arguments, real)
    sky = Sky(real, world.motion, world.epoch_jyear, arguments.seed, world)
    clock = SimulatedClock(arguments.speed, held=arguments.stepped)
    serial = f"SIM-{arguments.seed:04d}"
    identity = Identity(serial=serial, line_baud=arguments.baud)
    tracker = StarTracker(camera, sky, memory)
    with contextlib.suppress(Refusal):  # an unusable bank is reported when it is used
        tracker.warm()
    period_s = 1.0 / min(1000.0, max(0.001, arguments.housekeeping_hz))
    device = Device(
        load_dictionary(), identity, memory, tracker, clock(), framing=arguments.framing, housekeeping_s=period_s
    )
    return Terminal(line, device, clock, arguments.baud / 10, world.line), device, clock


def serve(terminal: Terminal, device: Device, clock: SimulatedClock, url: str, *, watch_stdin: bool) -> None:
    """Run until stopped. If ``watch_stdin``, time commands are read from standard input."""
    stopping = False

    def stop(*_: object) -> None:
        nonlocal stopping
        stopping = True

    signal.signal(signal.SIGTERM, stop)
    signal.signal(signal.SIGINT, stop)
    _say(f"READY {url}")
    desk = TimeDesk(clock, terminal, lambda: stopping)
    terminal.paced = not clock.held
    handles = [sys.stdin.fileno()] if watch_stdin else []
    try:
        while not stopping:
            ready = terminal.turn(BUSY_S if terminal.busy else IDLE_S, handles)
            if ready:
                data = os.read(ready[0], 4096)
                stopping = stopping or not data
                for answer in desk.feed(data):
                    _say(answer)
    finally:
        device.shut_down(clock())
        terminal.close()


def _say(line: str) -> None:
    sys.stdout.write(f"{line}\n")
    sys.stdout.flush()


def main(argv: Sequence[str] | None = None) -> int:
    """Parse the options, build the device and run it. Returns the exit code."""
    parser = argparse.ArgumentParser(prog="gss.device.simulator", description="A simulated star tracker on a line.")
    add_arguments(parser)
    arguments = parser.parse_args(argv)
    line: Line | None = None
    try:
        line = TcpLine(arguments.tcp) if arguments.tcp is not None else PtyLine(arguments.symlink)
        terminal, device, clock = make_terminal(arguments, line)
    except GssError as error:
        sys.stderr.write(f"simulator: {error}\n")
        if line is not None:
            line.close()
        return 2
    serve(terminal, device, clock, line.url, watch_stdin=arguments.exit_with_stdin or arguments.stepped)
    return 0


if __name__ == "__main__":
    sys.exit(main())
