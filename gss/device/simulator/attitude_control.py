"""Emulator of the attitude control that uses the matched vectors of a star sensor (Jacobs 1995 §3.4, §4.2.2).

The emulator is on the spacecraft, not on the ground. It receives the packet "matched_vectors" that the unit sends, and
turns the body against the orbit axes. Jacobs gives the exchange and the largest rate, but no control law.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from gss.catalogue_tools.envelope.attitude import euler_123
from gss.device.simulator.motion import EarthPointing
from gss.device.simulator.orbit import Orbit, Pose
from gss.device.simulator.reports import Report
from gss.domain.angles import Array
from gss.domain.rotation import matrix_from_quaternion, rotation_from_vector, vector_from_rotation
from gss.instruments.dictionary.definitions import Value
from gss.pipeline.attitude import q_method

FASTEST_RAD_S = float(np.radians(0.1))
"""Largest rate about each body axis (Jacobs 1995 §4.1)."""
GAIN_PER_S = 0.1
"""Commanded rate per angle. Chosen: the vectors are two to three seconds old, so the loop is stable up to 0.5 per second."""
EXCHANGE_S = 1.0
"""Period of the exchange (Jacobs 1995 §4.2.2). A command takes effect one period after its vectors are received, so
that it does not change an exposure that has begun."""
HOLD_S = 3.0
"""Time for which a command applies if no further vectors are received (chosen)."""
LEAST_VECTORS = 2
REMEMBERED_TURNS = 16


@dataclass(frozen=True)
class Turn:
    """Constant (3,) rate of the body against the orbit axes, from the (3, 3) attitude ``body_from_orbit`` at
    ``since_s`` until ``hold_s`` later."""

    since_s: float
    body_from_orbit: Array
    rate_rad_s: Array
    hold_s: float = HOLD_S

    def attitude(self, time_s: float) -> Array:
        """Return the (3, 3) body_from_orbit."""
        turned_s = float(np.clip(time_s - self.since_s, 0.0, self.hold_s))
        return np.asarray(rotation_from_vector(-self.rate_rad_s * turned_s) @ self.body_from_orbit)

    def rate(self, time_s: float) -> Array:
        """Return the (3,) rate in body axes."""
        return self.rate_rad_s if 0 <= time_s - self.since_s < self.hold_s else np.zeros(3)


class ControlledBody:
    """Motion of a camera on a body that its attitude control turns to ``target_rad``, (3,) roll, pitch and yaw.

    The body starts at ``start_rad`` and drifts with ``drift_rad_s`` about each body axis until the control receives
    vectors. ``cam_from_body``: (3, 3) mounting.
    """

    def __init__(
        self,
        orbit: Orbit,
        cam_from_body: Array,
        target_rad: Array,
        start_rad: Array,
        drift_rad_s: float = 0.0,
    ) -> None:
        self._axes = EarthPointing(orbit, np.eye(3))
        self._cam_from_body, self._target = cam_from_body, euler_123(target_rad)
        self._turns = [Turn(0.0, euler_123(start_rad), np.full(3, drift_rad_s), np.inf)]
        self._last_frame_s = -np.inf

    @property
    def orbit(self) -> Orbit:
        """The orbit of the body."""
        return self._axes.orbit

    def at(self, time_s: float) -> Pose:
        turn, axes = self._turn(time_s), self._axes.at(time_s)
        body_from_orbit = turn.attitude(time_s)
        rate_rad_s = turn.rate(time_s) + body_from_orbit @ axes.rate_rad_s
        return Pose(self._cam_from_body @ body_from_orbit @ axes.cam_from_icrs, self._cam_from_body @ rate_rad_s)

    def error_rad(self, time_s: float) -> float:
        """Return the true angle between the body and its target attitude."""
        turned = self._target @ self._turn(time_s).attitude(time_s).T
        return float(np.linalg.norm(vector_from_rotation(turned)))

    def receive(self, report: Report, time_s: float) -> None:
        """Command a rate from a packet that the unit sends at ``time_s``. Only the matched vectors of a new frame have an
        effect. Fewer than two vectors do not determine an attitude and give no command."""
        name, values, lists = report
        if name != "matched_vectors" or len(lists["items"]) < LEAST_VECTORS:
            return
        frame_s = float(values["frame_time_s"])
        if not frame_s > self._last_frame_s:
            return
        self._last_frame_s, since_s = frame_s, time_s + EXCHANGE_S
        command_rad_s = self._command_rad_s(lists["items"])
        self._turns.append(Turn(since_s, self._turn(since_s).attitude(since_s), command_rad_s))
        del self._turns[:-REMEMBERED_TURNS]

    def _command_rad_s(self, items: Sequence[Mapping[str, Value]]) -> Array:
        """Return the (3,) rate that reduces the measured error: proportional control with a limit on each axis."""
        body, orbit = (
            np.array([[float(item[f"{frame}_{axis}"]) for axis in "xyz"] for item in items])
            for frame in ("body", "orbit")
        )
        measured = matrix_from_quaternion(q_method(body, orbit))
        error_rad = vector_from_rotation(self._target @ measured.T)
        return np.asarray(np.clip(-GAIN_PER_S * error_rad, -FASTEST_RAD_S, FASTEST_RAD_S))

    def _turn(self, time_s: float) -> Turn:
        return next((t for t in reversed(self._turns) if t.since_s <= time_s), self._turns[0])
