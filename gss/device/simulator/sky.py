"""Images of the simulated camera: real stars at the simulated date, rendered with the profile's camera and sensor.

If all effects of the environment are switched off, the image contains only stars with proper motion. Aberration changes
the directions of the stars but not the true attitude, which refers to ICRS axes; the true star positions in the image
are the apparent ones.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from gss.catalogue_tools.corrections.corrections import aberrate
from gss.catalogue_tools.corrections.ephemeris import Bodies, BodyDisc
from gss.catalogue_tools.corrections.instrument_magnitude import as_seen_by
from gss.catalogue_tools.sources.hipparcos import load_stars, propagate
from gss.device.simulator.environment import Environment
from gss.device.simulator.images import Pixels
from gss.device.simulator.orbit import Motion, Pose
from gss.domain.angles import Array
from gss.domain.camera_profile import CameraProfile
from gss.domain.results import Truth
from gss.domain.stars import StarTable
from gss.pipeline.render import STAMP_SIGMAS, Lights, longest_trail_s, render, stars_near
from gss.pipeline.veil import Veil, earth_disc, earth_stray, halo, sun_stray

FAINTER_MAG = 2.5
DEEPEST_MAG = 8.0
ABERRATION_MARGIN_RAD = 1e-3
GOLDEN_ANGLE_RAD = float(np.pi * (3 - np.sqrt(5)))
MOON_POINTS = (80, 1200)
MOON_HALO_RAD = float(np.radians(12.0))
NEAR_FIELD_RAD = float(np.radians(1.0))


@dataclass(frozen=True)
class SimulatedExposure:
    """One image and the ground truth at mid-exposure. ``dark``: (rows, n) pixels of the dark columns, if the detector has any."""

    pixels: Pixels
    truth: Truth
    dark: Pixels | None = None


class SimulatedSky:
    """Renders exposures. Seed and frame number determine the noise; time and environment determine the scene.
    ``star_colours``: stars have the magnitude of the camera instead of V, also in the truth."""

    def __init__(
        self,
        profile: CameraProfile,
        motion: Motion,
        epoch_jyear: float,
        seed: int,
        environment: Environment | None = None,
        *,
        star_colours: bool = False,
    ) -> None:
        self._profile, self._seed = profile, seed
        self.environment = environment or Environment(profile, motion, epoch_jyear, seed)
        faintest = min(profile.sensor.faint_limit_mag + FAINTER_MAG, DEEPEST_MAG)
        self._stars = propagate(load_stars(faintest), epoch_jyear)
        if star_colours:
            self._stars = as_seen_by(self._stars, profile)

    def expose(self, mid_time_s: float, exposure_s: float, frame_number: int) -> SimulatedExposure:
        """Return an image with mid-exposure at ``mid_time_s`` (simulated time)."""
        world, profile = self.environment, self._profile
        pose = world.motion.at(mid_time_s)
        rng = np.random.default_rng(np.random.SeedSequence([self._seed, frame_number]))
        # If star trails are too long to render, only their middle part is rendered, with its share of the light.
        trail_s = 0.999 * longest_trail_s(profile.camera, profile.sensor, pose.rate_rad_s)
        share = min(1.0, trail_s / exposure_s)
        drawn = render(
            self._apparent(pose, mid_time_s, exposure_s),
            profile.camera,
            replace(profile.sensor, zero_point_e_s=profile.sensor.zero_point_e_s * share),
            pose.cam_from_icrs,
            exposure_s,
            rng,
            rate_rad_s=pose.rate_rad_s * share,
            lights=self._lights(pose, mid_time_s, min(exposure_s, trail_s)),
            veil=self._veil(pose, mid_time_s),
            chip=world.chip,
            hot_pixels=[replace(h, rate_e_s=h.rate_e_s * world.dark_factor) for h in world.hot_pixels],
            dark_factor=world.dark_factor,
            defects=world.defects,
        )
        return SimulatedExposure(drawn.pixels, drawn.truth, drawn.dark)

    def _apparent(self, pose: Pose, time_s: float, exposure_s: float) -> StarTable:
        if not self.environment.aberration:
            return self._stars
        margin_px = STAMP_SIGMAS * self._profile.sensor.psf_sigma_px
        sweep_rad = float(np.linalg.norm(pose.rate_rad_s)) * exposure_s
        near = stars_near(
            self._stars, self._profile.camera, pose.cam_from_icrs, margin_px, sweep_rad + ABERRATION_MARGIN_RAD
        )
        return replace(near, icrs=aberrate(near.icrs, self.environment.velocity_c(time_s)))

    def _lights(self, pose: Pose, time_s: float, trail_s: float) -> Lights | None:
        """Return the planets and the Moon's disc, if they are near the field of view. A smeared disc needs fewer
        points."""
        world = self.environment
        if not (world.planets or world.moon):
            return None
        bodies = world.bodies(time_s)
        icrs, v_mag = [np.zeros((0, 3))], [np.zeros(0)]
        if world.planets:
            icrs.append(bodies.planets_icrs)
            v_mag.append(bodies.planets_v_mag)
        if world.moon and self._near(bodies.moon.icrs, pose):
            pixel_rad = self._profile.camera.pixel_rad
            trail_px = float(np.linalg.norm(pose.rate_rad_s)) * trail_s / pixel_rad
            points, point_v_mag = moon_points(bodies, pixel_rad, 1 + trail_px)
            icrs.append(points)
            v_mag.append(np.full(len(points), point_v_mag))
        directions, brightness = np.concatenate(icrs), np.concatenate(v_mag)
        if world.aberration:
            directions = aberrate(directions, world.velocity_c(time_s))
        near = directions @ pose.cam_from_icrs[2] > self._near_cosine(NEAR_FIELD_RAD)
        return Lights(directions[near], brightness[near])

    def _veil(self, pose: Pose, time_s: float) -> Veil | None:
        """Return stray light of Sun, Earth and Moon, and the Earth's disc."""
        world, camera, sensor = self.environment, self._profile.camera, self._profile.sensor
        if not (world.sun or world.moon or world.earth):
            return None
        bodies, to_cam = world.bodies(time_s), pose.cam_from_icrs
        sun_cam, moon_cam = to_cam @ bodies.sun.icrs, to_cam @ bodies.moon.icrs
        e_s = np.zeros((camera.rows, camera.columns), np.float32)
        blocked = None
        if world.earth:
            nadir, earth_rad = world.earth_disc(time_s)
            if world.earth_angle_rad(time_s) < camera.half_diagonal_rad:
                blocked, shining = earth_disc(camera, sensor, to_cam @ nadir, earth_rad, sun_cam)
                e_s += shining
            lit = 0.0 if world.orbit.grounded else max(0.0, float(-nadir @ bodies.sun.icrs))
            if world.stray and lit > 0:
                e_s += earth_stray(camera, self._profile.baffle, to_cam @ nadir, earth_rad, lit)
        moon_near = world.moon and self._near(bodies.moon.icrs, pose, MOON_HALO_RAD)
        if moon_near and world.stray and not world.behind_earth(bodies.moon.icrs, time_s):
            e_s += halo(camera, sensor, moon_cam, bodies.moon.v_mag, MOON_HALO_RAD)
        if world.sun and (world.stray or world.blinded(time_s)) and not world.in_eclipse(time_s):
            e_s += sun_stray(camera, self._profile.baffle, sun_cam)
        return Veil(e_s, blocked)

    def _near(self, icrs: Array, pose: Pose, margin_rad: float = NEAR_FIELD_RAD) -> bool:
        return bool(pose.cam_from_icrs[2] @ icrs > self._near_cosine(margin_rad))

    def _near_cosine(self, margin_rad: float) -> float:
        return float(np.cos(min(np.pi, self._profile.camera.half_diagonal_rad + margin_rad)))


def moon_points(bodies: Bodies, pixel_rad: float, smear: float = 1.0) -> tuple[Array, float]:
    """Return (n, 3) directions distributed evenly over the Moon's lit side, and the magnitude of each direction.

    ``smear``: divisor of the number of points.
    """
    moon = bodies.moon
    count = int(np.clip(6 * (moon.radius_rad / pixel_rad) ** 2 / smear, *MOON_POINTS))
    order = np.arange(count)
    radius, angle = np.sqrt((order + 0.5) / count), order * GOLDEN_ANGLE_RAD
    toward_sun = bodies.sun.icrs * bodies.sun.distance_km - moon.icrs * moon.distance_km
    toward_sun /= np.linalg.norm(toward_sun)
    east, north = _perpendicular(moon)
    x, y = radius * np.cos(angle), radius * np.sin(angle)
    normal = x[:, None] * east + y[:, None] * north - np.sqrt(1 - radius**2)[:, None] * moon.icrs
    lit = normal @ toward_sun > 0
    if not lit.any():
        lit[int(np.argmax(normal @ toward_sun))] = True
    offset = np.tan(moon.radius_rad) * (x[lit, None] * east + y[lit, None] * north)
    points = moon.icrs + offset
    return points / np.linalg.norm(points, axis=1, keepdims=True), moon.v_mag + 2.5 * float(np.log10(lit.sum()))


def _perpendicular(disc: BodyDisc) -> tuple[Array, Array]:
    """Return two directions that are perpendicular to the direction of a body and to each other."""
    helper = np.eye(3)[int(np.argmin(np.abs(disc.icrs)))]
    east = np.cross(helper, disc.icrs)
    east /= np.linalg.norm(east)
    return east, np.cross(disc.icrs, east)
