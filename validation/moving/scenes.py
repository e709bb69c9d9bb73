"""Sequences of frames with satellites of a population, hot pixels, cosmic rays and uncatalogued stars."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gss.domain.angles import Array
from gss.domain.camera import Camera
from gss.domain.camera_profile import CameraProfile
from gss.domain.rotation import rotation_from_vector
from gss.domain.stars import StarTable
from gss.pipeline.readout import HotPixel, Image
from gss.pipeline.render import FalseStar, Lights, render
from validation.moving.population import EPOCH, Population, observer_km

HOT_PIXELS, RAYS, RAY_TRACKS, GLINTS, NEW_STARS = 8, 3.0, 0.3, 1.0, 2
EARTH_LIMB_KM = 6478.0
FARTHEST_KM = 45_000.0
NEAREST_KM = 150.0
TOP_RATE_RAD_S = float(np.radians(2.0))
EDGE_PX = 4.0


@dataclass(frozen=True)
class FrameTimes:
    """Sequence of ``frames`` frames, one every ``step_s``. ``near_share``: share of the sequences that point at a near
    object. ``trail_px``: shortest trail of the object at which the camera points."""

    frames: int
    step_s: float
    near_share: float
    trail_px: float


SEQUENCE = FrameTimes(10, 1.0, 0.5, 0.0)
SINGLE = FrameTimes(3, 30.0, 1.0, 8.0)
"""An object crosses the field between two frames, so it is a line in one frame."""


@dataclass(frozen=True)
class TrueTrack:
    """True track of one object in a scene. ``row``: row in the population. ``on``: (n,) True for frames with the object
    on the detector. ``icrs``: (n, 3) direction. ``snr``: (n,) signal-to-noise ratio of its light with a perfect filter.
    ``trail_px``: length of its trail."""

    row: int
    v_mag: float
    on: Array
    icrs: Array
    snr: Array
    trail_px: Array


@dataclass(frozen=True)
class Scene:
    """Frames with their times (Unix seconds), the observer's positions and the true tracks."""

    images: list[Image]
    times_s: Array
    observer_km: Array
    tracks: list[TrueTrack]


def scene(
    profile: CameraProfile,
    stars: StarTable,
    of: Population,
    magnitudes: tuple[float, float],
    rng: np.random.Generator,
    timing: FrameTimes = SEQUENCE,
) -> Scene:
    """Render one sequence whose pointing has at least one object in the field. ``magnitudes``: magnitude range of the
    objects."""
    middle = timing.frames // 2
    slowest_rad_s = timing.trail_px * profile.camera.pixel_rad / profile.sensor.exposure_s
    camera, sensor = profile.camera, profile.sensor
    while True:
        start_s = EPOCH.timestamp() + float(rng.uniform(0, 86_400))
        times_s: Array = start_s + timing.step_s * np.arange(timing.frames, dtype=float)
        place_km = observer_km(of.observer, times_s)
        icrs, distance_km = of.catalogue.seen_from(times_s, place_km)
        visible = _visible(icrs, distance_km, place_km, (slowest_rad_s, TOP_RATE_RAD_S), timing.step_s)
        if visible.any():
            break
    # Near objects are fast and rare, so half of the scenes point at one of them.
    near = 1 / distance_km[:, middle] ** (2 if rng.random() < timing.near_share else 0)
    weight = np.where(visible, near, 0.0)
    target = int(rng.choice(len(weight), p=weight / weight.sum()))
    rate = rng.normal(0, 1, 3) * np.radians(0.01 if rng.random() < 0.5 else 0.05)
    attitude = _pointing(camera, icrs[target, middle], rng)
    attitudes = [rotation_from_vector(-rate * (t - times_s[middle])) @ attitude for t in times_s]
    rows = [
        k
        for k in np.flatnonzero(visible).tolist()
        if any(camera.contains(camera.project(icrs[k, j] @ a.T)[None])[0] for j, a in enumerate(attitudes))
    ]
    v_mag = {k: float(rng.uniform(*magnitudes)) for k in rows}
    images: list[Image] = []
    tracks: dict[int, tuple[list[bool], list[float], list[float]]] = {k: ([], [], []) for k in rows}
    hot = [_hot(camera, sensor.full_well_e / sensor.exposure_s, rng) for _ in range(HOT_PIXELS)]
    lights = _new_stars(attitude, profile, rng)
    for j, at_s in enumerate(times_s):
        points: list[FalseStar] = []
        for k in rows:
            path = _path(of, k, float(at_s), of.observer, attitudes[j], rate, camera, sensor.exposure_s)
            inside = bool(camera.contains(path, EDGE_PX).all())
            length = float(np.hypot(*(path[-1] - path[0]))) if np.isfinite(path).all() else 0.0
            tracks[k][0].append(inside)
            tracks[k][1].append(_snr(profile, v_mag[k], length))
            tracks[k][2].append(length)
            points += _drawn(path, v_mag[k], sensor.psf_sigma_px)
        glints = int(rng.poisson(GLINTS))
        places = rng.uniform((0, 0), (camera.columns, camera.rows), (glints, 2))
        points += [FalseStar(float(c), float(r), float(rng.uniform(*magnitudes))) for c, r in places]
        rays = _rays(camera, sensor.full_well_e / sensor.exposure_s, rng)
        drawn = render(
            stars,
            camera,
            sensor,
            attitudes[j],
            sensor.exposure_s,
            rng,
            rate_rad_s=rate,
            hot_pixels=[*hot, *rays],
            false_stars=points,
            lights=lights,
        )
        images.append(drawn.pixels)
    tracks_of_objects = [
        TrueTrack(k, v_mag[k], np.array(on), icrs[k], np.array(snr), np.array(length))
        for k, (on, snr, length) in tracks.items()
    ]
    return Scene(images, times_s, place_km, tracks_of_objects)


def _visible(
    icrs: Array, distance_km: Array, place_km: Array, rates_rad_s: tuple[float, float], step_s: float
) -> Array:
    """Return the (m,) mask of the objects that the Earth does not hide and whose rate is within the limits."""
    down = -place_km / np.linalg.norm(place_km, axis=1, keepdims=True)
    limb = np.arcsin(EARTH_LIMB_KM / np.linalg.norm(place_km, axis=1))
    clear = np.einsum("mni,ni->mn", icrs, down) < np.cos(limb)
    step = np.linalg.norm(np.diff(icrs, axis=1), axis=2).max(axis=1) / step_s
    near = (distance_km > NEAREST_KM) & (distance_km < FARTHEST_KM)
    return np.asarray((clear & near).all(axis=1) & (step >= rates_rad_s[0]) & (step < rates_rad_s[1]))


def _pointing(camera: Camera, towards: Array, rng: np.random.Generator) -> Array:
    """Return a (3, 3) attitude with random roll that images a direction in the middle part of the detector."""
    side = rng.normal(size=3)
    x = side - towards * (side @ towards)
    x /= np.linalg.norm(x)
    on_axis = np.stack([x, np.cross(towards, x), towards])
    low = np.array([camera.columns, camera.rows]) * 0.2
    pixel = rng.uniform(low, 4 * low)
    seen = camera.unproject(pixel[None])[0]
    axis = np.cross(np.array([0.0, 0.0, 1.0]), seen)
    angle = np.arcsin(np.linalg.norm(axis))
    return np.asarray(rotation_from_vector(axis / np.linalg.norm(axis) * angle) @ on_axis)


def _path(
    of: Population,
    row: int,
    at_s: float,
    observer: str,
    attitude: Array,
    rate: Array,
    camera: Camera,
    exposure_s: float,
) -> Array:
    """Return the (n, 2) pixel positions of an object during the exposure."""
    after = np.linspace(-0.5, 0.5, 9) * exposure_s
    times_s = at_s + after
    icrs, _ = of.single(row).seen_from(times_s, observer_km(observer, times_s))
    turned = np.stack([rotation_from_vector(-rate * t) @ attitude for t in after])
    return camera.project(np.einsum("nij,nj->ni", turned, icrs[0]))


def _drawn(path: Array, v_mag: float, sigma_px: float) -> list[FalseStar]:
    """Return the light of an object along its path on the detector, as points."""
    if not np.isfinite(path).all():
        return []
    length = float(np.hypot(*(path[-1] - path[0])))
    count = int(np.ceil(length / (0.4 * sigma_px))) + 1
    share = (np.arange(count) + 0.5) / count * (len(path) - 1)
    places = np.column_stack([np.interp(share, np.arange(len(path)), path[:, k]) for k in (0, 1)])
    each = v_mag + 2.5 * float(np.log10(count))
    return [FalseStar(float(c), float(r), each) for c, r in places]


def _snr(profile: CameraProfile, v_mag: float, length_px: float) -> float:
    """Return the signal-to-noise ratio with a filter that is as long as the trail."""
    sensor = profile.sensor
    light = float(sensor.star_e(v_mag, sensor.exposure_s))
    sigma = float(np.hypot(sensor.psf_sigma_px, np.sqrt(1 / 12)))
    area_px = 4 * np.pi * sigma**2 + 2 * np.sqrt(np.pi) * sigma * length_px
    return light / float(np.sqrt(light + area_px * sensor.noise_e(sensor.exposure_s) ** 2))


def _hot(camera: Camera, full_e_s: float, rng: np.random.Generator) -> HotPixel:
    return HotPixel(
        int(rng.integers(camera.columns)), int(rng.integers(camera.rows)), float(full_e_s * rng.uniform(0.1, 1))
    )


def _rays(camera: Camera, full_e_s: float, rng: np.random.Generator) -> Sequence[HotPixel]:
    """Return the cosmic rays of one frame: single pixels, and tracks that are one pixel wide."""
    rays = [_hot(camera, full_e_s, rng) for _ in range(rng.poisson(RAYS))]
    for _ in range(rng.poisson(RAY_TRACKS)):
        angle, length = rng.uniform(0, np.pi), rng.uniform(4, 40)
        start, level = rng.uniform((0, 0), (camera.columns, camera.rows)), full_e_s * rng.uniform(0.05, 0.5)
        steps = np.arange(0, length, 0.5)
        cells = {(int(start[0] + s * np.cos(angle)), int(start[1] + s * np.sin(angle))) for s in steps}
        rays += [
            HotPixel(c, r, float(level)) for c, r in sorted(cells) if 0 <= c < camera.columns and 0 <= r < camera.rows
        ]
    return rays


def _new_stars(attitude: Array, profile: CameraProfile, rng: np.random.Generator) -> Lights:
    """Return stars that the catalogue does not contain."""
    camera, limit = profile.camera, profile.sensor.faint_limit_mag
    places = rng.uniform((0, 0), (camera.columns, camera.rows), (NEW_STARS, 2))
    return Lights(camera.unproject(places) @ attitude, rng.uniform(limit - 2, limit, NEW_STARS))
