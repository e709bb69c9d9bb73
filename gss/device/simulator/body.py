"""A simulated body with several heads, defined in a file that the simulators of all heads read (``--body FILE --head
NAME``).

The file states the attitude of the body over time, relative to a time zero in UTC, and for each head the nominal
mounting and the misalignment of the true mounting.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import AwareDatetime, Field, ValidationError

from gss.catalogue_tools.envelope.attitude import euler_123
from gss.device.simulator.motion import EarthPointing, Tumble
from gss.device.simulator.orbit import Inertial, Motion, Orbit, Pose
from gss.domain.angles import ARCSEC_RAD, Array
from gss.domain.errors import BadInput, NotFound
from gss.domain.frames import cam_from_icrs
from gss.domain.rotation import rotation_from_vector
from gss.instruments.marked_yaml import parse_yaml
from gss.instruments.quantities import Strict

HOUR_S = 3600.0
Angle = Annotated[float, Field(ge=-360, le=360)]
Angles = tuple[Angle, Angle, Angle]
Arcsec = Annotated[float, Field(ge=-36_000, le=36_000)]


class HeadOfBody(Strict):
    """One head. ``mounting_deg``: rotations about x, then y, then z that take the body's axes to the camera's.
    ``misalignment_arcsec``: rotation vector in body axes from this mounting to the true one at time zero;
    ``drift_arcsec_h``: change of this rotation vector per hour."""

    mounting_deg: Angles
    misalignment_arcsec: tuple[Arcsec, Arcsec, Arcsec] = (0.0, 0.0, 0.0)
    drift_arcsec_h: tuple[Arcsec, Arcsec, Arcsec] = (0.0, 0.0, 0.0)


class BodyFile(Strict):
    """A body with its heads. ``motion``: inertial, slew (about body y) and tumble begin at ``attitude_deg``, the right
    ascension and declination of body +z and the roll about it; with orbit, the body axes are aligned with the orbit
    axes (+z to nadir)."""

    time_zero: AwareDatetime
    motion: Literal["inertial", "slew", "tumble", "orbit"] = "inertial"
    attitude_deg: tuple[Angle, Annotated[float, Field(ge=-90, le=90)], Angle] = (84.0, 5.0, 0.0)
    rate_deg_s: Annotated[float, Field(ge=-20, le=20)] = 0.05
    heads: Annotated[dict[str, HeadOfBody], Field(min_length=1)]


@dataclass(frozen=True)
class MountedHead:
    """Motion of a head on a moving body. ``body``: attitude and rate of the body axes, in the form of a camera's
    motion; ``body_from_cam`` (3, 3): nominal mounting; (3,) ``misalignment_rad`` and ``drift_rad_s``, in body axes.
    ``offset_s``: time of the body at simulated time zero of the head."""

    body: Motion
    body_from_cam: Array
    misalignment_rad: Array
    drift_rad_s: Array
    offset_s: float = 0.0

    def at(self, time_s: float) -> Pose:
        since_s = time_s + self.offset_s
        pose = self.body.at(since_s)
        off = rotation_from_vector(self.misalignment_rad + self.drift_rad_s * since_s)
        cam_from_body = (off @ self.body_from_cam).T
        return Pose(cam_from_body @ pose.cam_from_icrs, cam_from_body @ (pose.rate_rad_s + self.drift_rad_s))


@dataclass(frozen=True)
class ShiftedOrbit:
    """An orbit whose time zero is ``offset_s`` before that of the simulation."""

    orbit: Orbit
    offset_s: float

    @property
    def grounded(self) -> bool:
        """True if the body is on the ground."""
        return self.orbit.grounded

    def state(self, time_s: float) -> tuple[Array, Array]:
        return self.orbit.state(time_s + self.offset_s)


def read_body(path: Path) -> BodyFile:
    """Read the file. Raises BadInput with line and field, or NotFound."""
    try:
        marked = parse_yaml(path.name, path.read_bytes())
    except OSError as error:
        raise NotFound("the file of the body cannot be read", expected="a YAML file", got=str(error)) from None
    try:
        return BodyFile.model_validate(marked.content)
    except ValidationError as error:
        first = error.errors()[0]
        raise marked.error(first["loc"], first["msg"].removeprefix("Value error, ")) from None


def head_motion(body: BodyFile, name: str, orbit: Orbit, offset_s: float) -> MountedHead:
    """Return the motion of a head. ``offset_s``: time of the body at simulated time zero. Raises NotFound for an
    unknown head."""
    if name not in body.heads:
        raise NotFound("the body has no such head", expected=" | ".join(body.heads), got=name, hint="use --head NAME")
    head = body.heads[name]
    return MountedHead(
        _motion(body, orbit),
        euler_123(np.radians(head.mounting_deg)).T,
        np.array(head.misalignment_arcsec) * ARCSEC_RAD,
        np.array(head.drift_arcsec_h) * ARCSEC_RAD / HOUR_S,
        offset_s,
    )


def _motion(body: BodyFile, orbit: Orbit) -> Motion:
    if body.motion == "orbit":
        if orbit.grounded:
            raise BadInput("a body on the ground has no orbit", expected="inertial | slew | tumble", got="orbit")
        return EarthPointing(orbit, np.eye(3))
    start, rate_rad_s = cam_from_icrs(*np.radians(body.attitude_deg)), float(np.radians(body.rate_deg_s))
    if body.motion == "tumble":
        return Tumble.of_rate(start, rate_rad_s)
    return Inertial(start, np.array([0.0, rate_rad_s if body.motion == "slew" else 0.0, 0.0]))
