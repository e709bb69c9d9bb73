"""``python -m gss.device.simulator``: one simulated star tracker on a pseudo-terminal or a TCP port.

Prints one line ``READY <url>`` when the link can be opened, and nothing else on standard output. Ends on SIGTERM,
SIGINT, or (asked for) when standard input closes.
"""

from __future__ import annotations

import argparse
import os
import signal
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from gss.device.dictionary_file import load_dictionary
from gss.device.golden import build_golden
from gss.device.simulator.factory import burn_golden
from gss.device.simulator.faults import FaultRates, LineFaults
from gss.device.simulator.firmware import StarTracker
from gss.device.simulator.machine import Device, Identity
from gss.device.simulator.memory import GOLDEN, Memory
from gss.device.simulator.orbit import Inertial, Motion, Zenith
from gss.device.simulator.sky import Sky
from gss.device.simulator.terminal import Line, PtyLine, TcpLine, Terminal
from gss.domain.errors import BadInput, GssError
from gss.domain.profiles import PROFILES, profile

IDLE_S = 0.01
BUSY_S = 0.001


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """All options."""
    add = parser.add_argument
    add("--profile", default="cubestar", choices=sorted(PROFILES), help="camera (default cubestar)")
    place = parser.add_mutually_exclusive_group()
    place.add_argument("--pty", action="store_true", help="pseudo-terminal (default)")
    place.add_argument("--tcp", type=int, metavar="PORT", help="TCP port on 127.0.0.1; 0 = a free one")
    add("--symlink", type=Path, metavar="PATH", help="name for the pseudo-terminal")
    add("--state-dir", type=Path, metavar="DIR", help="flash and record live here; without it they last for one run")
    add("--seed", type=int, default=1, help="noise and faults (default 1)")
    add("--baud", type=int, default=115_200, help="rate of the line, 8N1; 0 = not paced (default 115200)")
    add("--attitude", metavar="RA,DEC,ROLL", help="boresight and roll in degrees (inertial and slew)")
    add(
        "--motion",
        default="zenith",
        choices=("zenith", "inertial", "slew"),
        help="default zenith: an Earth-pointing orbit",
    )
    add("--rate-deg-s", type=float, default=0.05, help="turn rate of slew (default 0.05)")
    add("--epoch", type=float, default=2026.0, metavar="JYEAR", help="Julian year of the sky (default 2026.0)")
    add("--bit-error-rate", type=float, default=0.0, metavar="X", help="both directions (default 0)")
    add("--drop-rate", type=float, default=0.0, metavar="X", help="share of 64-byte pieces lost (default 0)")
    add("--stall-rate", type=float, default=0.0, metavar="X", help="stalls of half a second per second (default 0)")
    add("--speed", type=float, default=1.0, metavar="X", help="simulated seconds per second (default 1)")
    add("--exit-with-stdin", action="store_true", help="end when standard input closes")


def make_motion(arguments: argparse.Namespace) -> Motion:
    """The motion that the options ask for."""
    if arguments.motion == "zenith" and arguments.attitude is None:
        return Zenith()
    ra, dec, roll = _angles(arguments.attitude or "84,5,0")
    rate = (0.0, np.radians(arguments.rate_deg_s), 0.0) if arguments.motion == "slew" else (0.0, 0.0, 0.0)
    return Inertial.pointing(np.radians(ra), np.radians(dec), np.radians(roll), rate)


def _angles(text: str) -> tuple[float, float, float]:
    try:
        ra, dec, roll = map(float, text.split(","))
    except ValueError:
        raise BadInput("unreadable attitude", expected="RA,DEC,ROLL in degrees", got=text) from None
    if not -90 <= dec <= 90:
        raise BadInput("declination is out of range", expected="−90 – 90", got=f"{dec:g}")
    return ra, dec, roll


def make_clock(speed: float, real: Callable[[], float] = time.monotonic) -> Callable[[], float]:
    """Simulated seconds since now."""
    if not 0 < speed <= 1000:
        raise BadInput("speed is out of range", expected="above 0, at most 1000", got=f"{speed:g}")
    start_s = real()
    return lambda: (real() - start_s) * speed


def make_terminal(arguments: argparse.Namespace, line: Line) -> tuple[Terminal, Device, Callable[[], float]]:
    """The device on its line."""
    camera = profile(arguments.profile)
    memory = Memory.in_directory(arguments.state_dir) if arguments.state_dir else Memory.in_ram()
    held = memory.record.banks[GOLDEN]
    if held.profile != camera.name or not memory.intact(GOLDEN):
        burn_golden(memory, camera, build_golden(camera, memory.bank_bytes))
    sky = Sky(camera, make_motion(arguments), arguments.epoch, arguments.seed)
    clock = make_clock(arguments.speed)
    serial = f"SIM-{arguments.seed:04d}"
    identity = Identity(serial=serial, line_baud=arguments.baud)
    device = Device(load_dictionary(), identity, memory, StarTracker(camera, sky, memory), clock())
    rates = FaultRates(arguments.bit_error_rate, arguments.drop_rate, 0.0, arguments.stall_rate)
    up, down = LineFaults(rates, 2 * arguments.seed), LineFaults(rates, 2 * arguments.seed + 1)
    return Terminal(line, device, clock, arguments.baud / 10, up, down), device, clock


def serve(terminal: Terminal, device: Device, clock: Callable[[], float], url: str, *, watch_stdin: bool) -> None:
    """Run until told to stop."""
    stopping = False

    def stop(*_: object) -> None:
        nonlocal stopping
        stopping = True

    signal.signal(signal.SIGTERM, stop)
    signal.signal(signal.SIGINT, stop)
    sys.stdout.write(f"READY {url}\n")
    sys.stdout.flush()
    handles = [sys.stdin.fileno()] if watch_stdin else []
    try:
        while not stopping:
            ready = terminal.turn(BUSY_S if terminal.busy else IDLE_S, handles)
            if ready and not os.read(ready[0], 1024):
                stopping = True
    finally:
        device.shut_down(clock())
        terminal.close()


def main(argv: Sequence[str] | None = None) -> int:
    """Parse, build, serve."""
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
    serve(terminal, device, clock, line.url, watch_stdin=arguments.exit_with_stdin)
    return 0


if __name__ == "__main__":
    sys.exit(main())
