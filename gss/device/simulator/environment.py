"""Simulated conditions that an exercise can change: motion, bodies, detector defects, temperature, the line.

Attributes may be set at any time and affect the next exposure. Times are simulated seconds.
"""

from __future__ import annotations

import itertools

import numpy as np

from gss.catalogue_tools.corrections.ephemeris import DAY_S, LIGHT_KM_S, Bodies, bodies_at, earth_pole_icrs
from gss.device.simulator.attitude_control import ControlledBody
from gss.device.simulator.body import MountedHead
from gss.device.simulator.faults import LineControl
from gss.device.simulator.motion import EarthFixed, EarthPointing, SlewTo, Tumble
from gss.device.simulator.orbit import (
    DAYS_PER_YEAR,
    EARTH_RADIUS_KM,
    CircularOrbit,
    GroundSite,
    Inertial,
    Motion,
    Orbit,
    Zenith,
)
from gss.device.simulator.reports import Report
from gss.domain.angles import Array
from gss.domain.camera_profile import CameraProfile
from gss.domain.errors import BadInput
from gss.domain.frames import cam_from_icrs
from gss.domain.sensor import NO_DEFECTS, Defects
from gss.pipeline.chip import Chip, make_chip
from gss.pipeline.readout import HotPixel

MOTIONS = ("zenith", "inertial", "slew", "tumble", "ground", "point")
FASTEST_RAD_S = float(np.radians(20.0))
DARK_DOUBLING_C = 8.0
HOT_SIDE_PX = 3
"""Side of a group of hot pixels. A single hot pixel is rejected by the minimum area of most chains."""
HOT_LEVEL = (0.3, 0.9)
"""Signal of hot pixels in the nominal exposure, as a share of the saturation level."""
MEAN_C, SWING_C, LAG_S = 12.0, 6.0, 600.0
SUN_STEP_S = 60.0


class Environment:
    """Environment of one simulated camera. Stars are always present; the switches add all other effects."""

    def __init__(
        self,
        profile: CameraProfile,
        motion: Motion,
        epoch_jyear: float = 2026.0,
        seed: int = 1,
        *,
        orbit: Orbit | None = None,
        line: LineControl | None = None,
        aberration: bool = False,
    ) -> None:
        self.profile, self.motion, self.epoch_jyear, self.seed = profile, motion, epoch_jyear, seed
        self.orbit: Orbit = orbit or (motion.orbit if isinstance(motion, Zenith) else CircularOrbit())
        self.line = line or LineControl(seed=seed)
        # Motion that "zenith" restores: the initial motion if it is Earth-pointing or that of a body with several
        # heads, otherwise an Earth-pointing motion on the initial orbit.
        sky_bound = isinstance(motion, Zenith | EarthPointing | MountedHead | ControlledBody)
        flown = CircularOrbit() if self.orbit.grounded else self.orbit
        self._home: tuple[Motion, Orbit] = (motion if sky_bound else EarthPointing(flown), flown)
        self.aberration = aberration
        self.planets = self.moon = self.sun = self.earth = self.stray = False
        self.defects: Defects = NO_DEFECTS
        self.temperature_offset_c = 0.0
        self.hot_pixels: tuple[HotPixel, ...] = ()
        self._chip: tuple[Defects, Chip | None] = (NO_DEFECTS, None)
        self._bodies: tuple[float, Bodies] | None = None
        self._sun: tuple[float, Array] | None = None

    def make_real(self, on: bool = True) -> None:
        """Switch all effects on or off except aberration, which the ground does not correct."""
        self.planets = self.moon = self.sun = self.earth = self.stray = on
        self.set_defects(on)

    def set_defects(self, on: bool) -> None:
        """Use the camera's documented defects, or a perfect detector."""
        self.defects = self.profile.defects if on else NO_DEFECTS

    @property
    def chip(self) -> Chip | None:
        """Detector with its defects; None for a perfect detector."""
        if self._chip[0] != self.defects:
            flawless = self.defects == NO_DEFECTS
            chip = None if flawless else make_chip(self.defects, self.profile.sensor, self.profile.camera, self.seed)
            self._chip = (self.defects, chip)
        return self._chip[1]

    def set_hot_pixels(self, groups: int) -> None:
        """Make this number of groups of 3 x 3 pixels hot, at places that depend on the seed; 0 for none."""
        camera, sensor = self.profile.camera, self.profile.sensor
        rng = np.random.default_rng([self.seed, HOT_SIDE_PX])
        full_e_s = sensor.saturation_dn * sensor.gain_e_per_dn / sensor.exposure_s
        pixels: dict[tuple[int, int], HotPixel] = {}
        for _ in range(groups):
            col, row = (int(rng.integers(n - HOT_SIDE_PX + 1)) for n in (camera.columns, camera.rows))
            for c, r in itertools.product(range(col, col + HOT_SIDE_PX), range(row, row + HOT_SIDE_PX)):
                pixels[c, r] = HotPixel(c, r, float(rng.uniform(*HOT_LEVEL)) * full_e_s)
        self.hot_pixels = tuple(pixels.values())

    @property
    def dark_factor(self) -> float:
        """Dark current relative to that of the profile; it doubles every 8 °C."""
        return float(2.0 ** (self.temperature_offset_c / DARK_DOUBLING_C))

    # --- motion -------------------------------------------------------------------------------------------------

    def set_motion(
        self,
        kind: str,
        time_s: float,
        *,
        rate_rad_s: float = 0.0,
        ra_rad: float = 0.0,
        dec_rad: float = 0.0,
        roll_rad: float = 0.0,
        duration_s: float = 60.0,
        from_rad: tuple[float, float, float] | None = None,
    ) -> None:
        """Change the motion, starting from the current attitude.

        ``kind``: "zenith" returns to the orbit; "inertial" is fixed; "slew" rotates about camera y; "tumble"; "ground"
        rotates with the Earth; "point" rotates to a target within ``duration_s``. ``from_rad``: right ascension,
        declination and roll at which the motion starts instead. Raises BadInput for an unknown kind or a rate out of
        range.
        """
        if kind not in MOTIONS:
            raise BadInput("unknown motion", expected=" | ".join(MOTIONS), got=kind)
        if not abs(rate_rad_s) <= FASTEST_RAD_S:
            expected = f"at most {np.degrees(FASTEST_RAD_S):g} °/s"
            raise BadInput("the rate is out of range", expected=expected, got=f"{np.degrees(rate_rad_s):g} °/s")
        now = self.motion.at(time_s).cam_from_icrs if from_rad is None else cam_from_icrs(*from_rad)
        if kind == "zenith":
            self.motion, self.orbit = self._home
        elif kind == "inertial":
            self.motion = Inertial(now, np.zeros(3), time_s)
        elif kind == "slew":
            self.motion = Inertial(now, np.array([0.0, rate_rad_s, 0.0]), time_s)
        elif kind == "tumble":
            self.motion = Tumble.of_rate(now, rate_rad_s, time_s)
        elif kind == "ground":
            self.motion, self.orbit = on_the_ground(now, self.epoch_jyear, time_s)
        else:
            self.motion = SlewTo(now, cam_from_icrs(ra_rad, dec_rad, roll_rad), time_s, duration_s)

    def receive(self, report: Report, time_s: float) -> None:
        """Pass a packet that the unit sends at ``time_s`` to the attitude control, if the body has one."""
        if isinstance(self.motion, ControlledBody):
            self.motion.receive(report, time_s)

    def rate_rad_s(self, time_s: float) -> float:
        """Return the camera's angular speed in rad/s."""
        return float(np.linalg.norm(self.motion.at(time_s).rate_rad_s))

    # --- geometry -----------------------------------------------------------------------------------------------

    def jyear(self, time_s: float) -> float:
        """Return the Julian year, Terrestrial Time."""
        return self.epoch_jyear + time_s / DAY_S / DAYS_PER_YEAR

    def bodies(self, time_s: float) -> Bodies:
        """Return Sun, Moon and planets as seen from the camera."""
        if self._bodies is None or self._bodies[0] != time_s:
            self._bodies = (time_s, bodies_at(self.jyear(time_s), self.orbit.state(time_s)[0]))
        return self._bodies[1]

    def velocity_c(self, time_s: float) -> Array:
        """Return the (3,) barycentric velocity of the camera in units of c, for annual and orbital aberration."""
        return self.bodies(time_s).earth_velocity_c + self.orbit.state(time_s)[1] / LIGHT_KM_S

    def earth_disc(self, time_s: float) -> tuple[Array, float]:
        """Return the (3,) ICRS direction to the Earth's centre and its angular radius."""
        place_km = self.orbit.state(time_s)[0]
        distance_km = float(np.linalg.norm(place_km))
        return -place_km / distance_km, float(np.arcsin(min(1.0, EARTH_RADIUS_KM / distance_km)))

    def behind_earth(self, icrs: Array, time_s: float) -> bool:
        """True if the (3,) direction is hidden by the Earth."""
        nadir, earth_rad = self.earth_disc(time_s)
        return bool(nadir @ icrs > np.cos(earth_rad))

    def in_eclipse(self, time_s: float) -> bool:
        """True if the Sun's centre is behind the Earth; always True on the ground, because ground tests take place at
        night."""
        return self.orbit.grounded or self.behind_earth(self.bodies(time_s).sun.icrs, time_s)

    def sun_angle_rad(self, time_s: float) -> float:
        """Return the angle from the boresight to the Sun's centre."""
        return self._from_boresight_rad(self.bodies(time_s).sun.icrs, time_s)

    def earth_angle_rad(self, time_s: float) -> float:
        """Return the angle from the boresight to the Earth's limb; negative if the boresight meets the Earth."""
        nadir, earth_rad = self.earth_disc(time_s)
        return self._from_boresight_rad(nadir, time_s) - earth_rad

    def blinded(self, time_s: float) -> bool:
        """True if the Sun is simulated and shines on the lens."""
        shining = self.sun and not self.in_eclipse(time_s)
        return shining and self.sun_angle_rad(time_s) < self.profile.baffle.blind_rad

    def sensor_temperature_c(self, time_s: float) -> float:
        """Return the detector temperature: it follows the orbit's day and night with a lag. The exercise's offset is
        added."""
        place_km = self.orbit.state(time_s - LAG_S)[0]
        side = float(place_km @ self._warming_sun(time_s) / np.linalg.norm(place_km))
        return MEAN_C + SWING_C * side + self.temperature_offset_c

    def _warming_sun(self, time_s: float) -> Array:
        """Return the (3,) ICRS direction to the Sun at the last multiple of ``SUN_STEP_S``; it moves 1° in a day."""
        step_s = time_s // SUN_STEP_S * SUN_STEP_S
        if self._sun is None or self._sun[0] != step_s:
            self._sun = (step_s, bodies_at(self.jyear(step_s)).sun.icrs)
        return self._sun[1]

    def _from_boresight_rad(self, icrs: Array, time_s: float) -> float:
        boresight = self.motion.at(time_s).cam_from_icrs[2]
        return float(np.arctan2(np.linalg.norm(np.cross(boresight, icrs)), boresight @ icrs))


def on_the_ground(attitude: Array, epoch_jyear: float, time_s: float = 0.0) -> tuple[EarthFixed, GroundSite]:
    """Return motion and site of a camera fixed to the Earth whose (3, 3) attitude points to the zenith at
    ``time_s``."""
    pole = earth_pole_icrs(epoch_jyear)
    motion = EarthFixed(attitude, pole, time_s)
    return motion, GroundSite(motion.at(0.0).cam_from_icrs[2], pole)
