"""Command-line options of the simulator, and the environment they define."""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from gss.catalogue_tools.envelope.attitude import BODY_FROM_CAM, ORBIT_LAWS
from gss.device.protocol.framing import FRAMINGS
from gss.device.simulator.attitude_control import ControlledBody
from gss.device.simulator.body import ShiftedOrbit, head_motion, read_body
from gss.device.simulator.environment import Environment, on_the_ground
from gss.device.simulator.faults import FaultRates, LineControl
from gss.device.simulator.motion import EarthPointing, Tumble
from gss.device.simulator.orbit import CircularOrbit, Inertial, Motion, Orbit, Sgp4Orbit, Zenith
from gss.domain.angles import Array
from gss.domain.camera_profile import CameraProfile
from gss.domain.errors import BadInput, NotFound
from gss.domain.frames import cam_from_icrs
from gss.instruments.package import Instrument, load_instrument
from gss.instruments.package_files import Mounting, SimulatorFile
from gss.instruments.package_source import read_package_files
from gss.instruments.registry import shipped_registry

DEFAULT_EPOCH_JYEAR = 2026.0
MOTION_WORDS = (
    "zenith, nadir: on an orbit, camera to the zenith; controlled: an attitude control turns the body by the matched vectors "
    "that the unit sends; other motions begin at --attitude (default: from the instrument)"
)
FAULT_WORDS = "share of 64-byte pieces"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add all options to the parser."""
    add = parser.add_argument
    add(
        "--instrument",
        "--profile",
        required=True,
        metavar="NAME",
        help="shipped instrument, or the folder or .zip of a package (gss simulate: default GSS_INSTRUMENT)",
    )
    add("--state-dir", type=Path, metavar="DIR", help="folder of flash and record; without it they last for one run")
    add("--seed", type=int, default=1, help="seed of noise, detector and faults (default 1)")
    add(
        "--dialect",
        action="append",
        default=[],
        metavar="NAME",
        help="reproduce a documented deviation of a third-party unit; can be repeated (docs/instruments.md)",
    )
    _add_sky(parser.add_argument_group("sky and motion"))
    _add_line(parser.add_argument_group("line"))
    _add_time(parser.add_argument_group("time"))


def _add_sky(group: argparse._ArgumentGroup) -> None:
    add = group.add_argument
    add(
        "--sky",
        default="stars",
        choices=("stars", "real"),
        help="real: planets, Moon, Sun, Earth, stray light, defects",
    )
    add(
        "--star-colours",
        action="store_true",
        help="brightness of stars by colour index and spectral response of the camera (default: from the instrument)",
    )
    add(
        "--aberration",
        action="store_true",
        help="stars at their apparent positions; ground results then differ by up to 26″",
    )
    add(
        "--lens-off",
        type=float,
        default=0.0,
        metavar="PERCENT",
        help="error of focal length, centre and distortion; the flash contains the values of the document (default 0)",
    )
    add("--epoch", type=float, metavar="JYEAR", help="Julian year of the sky (default 2026.0, or the TLE's)")
    add(
        "--motion",
        choices=("zenith", "nadir", "inertial", "slew", "tumble", "ground", "controlled"),
        help=MOTION_WORDS,
    )
    add("--attitude", metavar="RA,DEC,ROLL", help="boresight and roll in degrees; ground: declination is the latitude")
    add(
        "--rate-deg-s",
        type=float,
        default=0.05,
        help="angular rate of slew and tumble, drift about each body axis of controlled (default 0.05)",
    )
    add("--tle", type=Path, metavar="FILE", help="orbit from a two-line element set")
    add("--altitude-km", type=float, default=600.0, help="altitude of the circular orbit (default 600)")
    add("--inclination-deg", type=float, default=97.8, help="inclination of the circular orbit (default 97.8)")
    add("--raan-deg", type=float, default=84.0, help="ascending node of the circular orbit (default 84)")
    add(
        "--latitude-argument-deg",
        type=float,
        default=0.0,
        help="position on the circular orbit at the start (default 0)",
    )
    add(
        "--mounting",
        choices=ORBIT_LAWS,
        help="mounting of the camera in the body (default: from the instrument)",
    )
    add(
        "--roll-pitch-yaw",
        metavar="R,P,Y",
        help="attitude of the body against the orbit axes in degrees (default: from the instrument)",
    )
    add(
        "--body",
        type=Path,
        metavar="FILE",
        help="file of a body with several simulated heads: common attitude and time, mountings, misalignment and its drift "
        "(docs/heads.md)",
    )
    add("--head", default="", metavar="NAME", help="head of the body to simulate; a server uses the names of its units")


def _add_line(group: argparse._ArgumentGroup) -> None:
    add = group.add_argument
    place = group.add_mutually_exclusive_group()
    place.add_argument("--pty", action="store_true", help="pseudo-terminal (default)")
    place.add_argument("--tcp", type=int, metavar="PORT", help="TCP port on 127.0.0.1; 0 = a free one")
    place.add_argument(
        "--can",
        type=int,
        metavar="PORT",
        help="UDP port of the CAN bus on this machine, for an instrument on CAN; 0 = a free one (default)",
    )
    add("--symlink", type=Path, metavar="PATH", help="name for the pseudo-terminal")
    add("--baud", type=int, help="rate of the line, 8N1; 0 = not paced (default: the instrument's)")
    add("--keys", type=Path, default=None, metavar="FILE", help="accept only packets signed with these link keys")
    add("--framing", choices=sorted(FRAMINGS), help="framing of the packets (default: the instrument's)")
    add(
        "--bit-error-rate",
        type=float,
        default=0.0,
        metavar="X",
        help="in both directions, like all line faults (default 0)",
    )
    add("--burst-rate", type=float, default=0.0, metavar="X", help=f"{FAULT_WORDS} with up to 16 bytes of noise")
    add("--drop-rate", type=float, default=0.0, metavar="X", help=f"{FAULT_WORDS} lost (default 0)")
    add("--duplicate-rate", type=float, default=0.0, metavar="X", help=f"{FAULT_WORDS} sent twice (default 0)")
    add("--stall-rate", type=float, default=0.0, metavar="X", help="stalls of half a second per second (default 0)")
    add("--delay-ms", type=float, default=0.0, metavar="X", help="delay of every byte (default 0)")


def _add_time(group: argparse._ArgumentGroup) -> None:
    add = group.add_argument
    add("--speed", type=float, default=1.0, metavar="X", help="simulated seconds per second (default 1)")
    add(
        "--stepped",
        action="store_true",
        help="time is stopped until standard input receives: step SECONDS | skip SECONDS | run [X] | pause",
    )
    add("--paced", action="store_true", help="limit the line to its rate also while time is stepped")
    add(
        "--housekeeping-hz",
        type=float,
        metavar="X",
        help="housekeeping packets per second, to load a ground system (default: the instrument's)",
    )
    add("--exit-with-stdin", action="store_true", help="end when standard input closes")


def instrument_of(arguments: argparse.Namespace) -> Instrument:
    """Return the instrument to simulate. Raises NotFound or BadInput."""
    name: str = arguments.instrument
    if name in shipped_registry().names():
        return shipped_registry().get(name)
    if not Path(name).exists():
        raise NotFound(
            "unknown instrument", expected=" | ".join(shipped_registry().names()) + ", or a package", got=name
        )
    return load_instrument(read_package_files(Path(name)))


def make_environment(
    arguments: argparse.Namespace, camera: CameraProfile, instrument: Instrument, utc_zero_s: float = 0.0
) -> Environment:
    """Return the environment that the options define. ``instrument``: provides mounting and motion if the options do
    not. ``utc_zero_s``: UTC of simulated time zero, as Unix time, for a body with a separate time zero."""
    orbit, epoch_jyear = _orbit(arguments)
    if arguments.body is None:
        motion, orbit = make_motion(arguments, instrument, orbit, epoch_jyear)
    else:
        motion, orbit = _on_a_body(arguments, orbit, utc_zero_s)
    line = LineControl(make_rates(arguments), arguments.seed)
    world = Environment(
        camera, motion, epoch_jyear, arguments.seed, orbit=orbit, line=line, aberration=arguments.aberration
    )
    if arguments.sky == "real":
        world.make_real()
    return world


def make_rates(arguments: argparse.Namespace) -> FaultRates:
    """Return the line's initial faults."""
    a = arguments
    return FaultRates(
        bit_error_rate=a.bit_error_rate,
        drop_rate=a.drop_rate,
        duplicate_rate=a.duplicate_rate,
        stall_rate=a.stall_rate,
        burst_rate=a.burst_rate,
        delay_s=a.delay_ms / 1000,
    )


def _orbit(arguments: argparse.Namespace) -> tuple[Orbit, float]:
    """Return the orbit and the Julian year of time zero."""
    if arguments.tle is not None:
        try:
            text = arguments.tle.read_text("utf-8")
        except (OSError, UnicodeDecodeError) as error:
            raise NotFound("the TLE file cannot be read", expected="two lines of text", got=str(error)) from None
        flown = Sgp4Orbit(text, arguments.epoch)
        return flown, flown.epoch_jyear
    epoch_jyear = DEFAULT_EPOCH_JYEAR if arguments.epoch is None else arguments.epoch
    if not 100 <= arguments.altitude_km <= 400_000:
        raise BadInput("altitude is out of range", expected="100 – 400 000 km", got=f"{arguments.altitude_km:g} km")
    inclination, node, place = (
        float(np.radians(angle))
        for angle in (arguments.inclination_deg, arguments.raan_deg, arguments.latitude_argument_deg)
    )
    return CircularOrbit(arguments.altitude_km, inclination, node, place), float(epoch_jyear)


def make_motion(
    arguments: argparse.Namespace, instrument: Instrument, orbit: Orbit, epoch_jyear: float
) -> tuple[Motion, Orbit]:
    """Return the attitude motion and the orbit; for a camera on the ground the site replaces the orbit."""
    kind = arguments.motion or (instrument.simulator or SimulatorFile()).motion
    if kind in ("zenith", "nadir") and arguments.attitude is None:
        return _earth_pointing(arguments, instrument.about.mounting, orbit), orbit
    if kind == "controlled":
        return _controlled(arguments, instrument.about.mounting, orbit), orbit
    ra, dec, roll = _angles(arguments.attitude or "84,5,0", "RA,DEC,ROLL")
    if not -90 <= dec <= 90:
        raise BadInput("declination is out of range", expected="−90 – 90", got=f"{dec:g}")
    start: Array = cam_from_icrs(*np.radians([ra, dec, roll]))
    rate_rad_s = float(np.radians(arguments.rate_deg_s))
    if kind == "ground":
        return on_the_ground(start, epoch_jyear)
    if kind == "tumble":
        return Tumble.of_rate(start, rate_rad_s), orbit
    return Inertial(start, np.array([0.0, rate_rad_s if kind == "slew" else 0.0, 0.0])), orbit


def _on_a_body(arguments: argparse.Namespace, orbit: Orbit, utc_zero_s: float) -> tuple[Motion, Orbit]:
    """Return the motion and the orbit of one head of a body."""
    options = {"motion": "motion", "attitude": "attitude", "mounting": "mounting", "roll_pitch_yaw": "roll-pitch-yaw"}
    conflicting = [f"--{option}" for name, option in options.items() if getattr(arguments, name) is not None]
    if conflicting:
        raise BadInput(
            "the file of the body already states motion and mountings",
            expected="--body alone",
            got=", ".join(conflicting),
        )
    if arguments.stepped or arguments.speed != 1.0:
        raise BadInput("heads of one body need real time", expected="neither --speed nor --stepped with --body")
    body = read_body(arguments.body)
    offset_s = utc_zero_s - body.time_zero.timestamp()
    return head_motion(body, arguments.head, orbit, offset_s), ShiftedOrbit(orbit, offset_s)


def _earth_pointing(arguments: argparse.Namespace, built_in: Mounting, orbit: Orbit) -> Motion:
    mounting, body = built_in.camera, built_in.at_rest_deg
    if arguments.mounting not in (None, mounting):
        mounting, body = arguments.mounting, (0.0, 0.0, 0.0)
    if arguments.roll_pitch_yaw:
        body = _angles(arguments.roll_pitch_yaw, "ROLL,PITCH,YAW")
    roll, pitch, yaw = (float(np.radians(angle)) for angle in body)
    if isinstance(orbit, CircularOrbit) and mounting == "zenith" and not any(body):
        return Zenith(orbit.altitude_km, orbit.inclination_rad, orbit.raan_rad, orbit.start_rad)
    return EarthPointing(orbit, BODY_FROM_CAM[mounting].T, (roll, pitch, yaw))


def _controlled(arguments: argparse.Namespace, built_in: Mounting, orbit: Orbit) -> Motion:
    """Return a body that starts at --roll-pitch-yaw and is turned to the instrument's attitude. The matched vectors are in
    the body axes of Jacobs 1995 §1.3, so the control works with this mounting only."""
    if built_in.camera != "sunsat" or arguments.mounting not in (None, "sunsat") or arguments.attitude is not None:
        raise BadInput(
            "the attitude control uses matched vectors in Sunsat's body axes",
            expected="an instrument with the mounting sunsat, and neither another --mounting nor --attitude",
            got=built_in.camera if arguments.mounting is None else arguments.mounting,
            hint="use --instrument sunsat, and --roll-pitch-yaw for the attitude at the start",
        )
    target = np.radians(built_in.at_rest_deg)
    start = target
    if arguments.roll_pitch_yaw:
        start = np.radians(_angles(arguments.roll_pitch_yaw, "ROLL,PITCH,YAW"))
    drift_rad_s = float(np.radians(arguments.rate_deg_s))
    return ControlledBody(orbit, BODY_FROM_CAM["sunsat"].T, target, start, drift_rad_s)


def _angles(text: str, option: str) -> tuple[float, float, float]:
    try:
        first, second, third = map(float, text.split(","))
    except ValueError:
        raise BadInput("the angles cannot be read", expected=f"{option} in degrees", got=text) from None
    return first, second, third
