""" "Never wrong" campaign on rendered frames with faults of sky and detector, for each camera's chain and the reference
chain."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gss.domain.angles import Array
from gss.domain.camera_profile import CameraProfile
from gss.domain.results import SolveResult, Truth, Verdict
from gss.domain.stars import StarTable
from gss.instruments.registry import shipped_camera
from gss.pipeline.chains import onboard, reference
from gss.pipeline.chains.modes import Mode
from gss.pipeline.chains.systems import system
from gss.pipeline.readout import HotPixel
from gss.pipeline.render import FalseStar, Lights, render
from gss.pipeline.score import assess
from validation.never_wrong.faults import PLANET_MAG, FieldLocation, attitude_at
from validation.never_wrong.lists import CAMERAS, CHAINS, OWN, Verdicts, setting_of
from validation.never_wrong.sky import (
    OTHER_CAMERA,
    Setting,
    hint_of,
    prior,
    reference_hint,
    reference_sky,
    works_of,
)
from validation.never_wrong.table import MODES

Frames = NDArray[Any]
FrameSolver = Callable[[Frames, Mode, Array | None], SolveResult]
FRAME_SHARD = 13
"""Number of frames per shard: one for each fault."""
_STREAM = 911


@dataclass(frozen=True)
class FrameFault:
    """One fault of a frame. ``exposure``: factor by which the camera's exposure is multiplied; ``rate_rad_s``: rotation
    rate about a random axis; ``flat``: constant pixel value as a fraction of full scale, without stars; ``starless``:
    True if the frame has only noise. The other attributes are those of ``Fault``."""

    title: str
    false: int = 0
    planets: int = 0
    hot: int = 0
    exposure: float = 1.0
    rate_rad_s: float = 0.0
    scale: float = 1.0
    mirrored: bool = False
    another: bool = False
    starless: bool = False
    flat: float | None = None
    place: FieldLocation = FieldLocation.ANYWHERE


FRAME_FAULTS = (
    FrameFault("frame, no fault"),
    FrameFault("frame, 10 false stars", false=10),
    FrameFault("frame, 100 false stars", false=100),
    FrameFault("frame, 4 planets", planets=4),
    FrameFault("frame, 300 hot pixels", hot=300),
    FrameFault("frame, saturated: 40 times the exposure", exposure=40.0),
    FrameFault("frame, trailed: 0.3°/s", rate_rad_s=float(np.radians(0.3))),
    FrameFault("frame, focal length +1 %", scale=1.01),
    FrameFault("frame, mirrored", mirrored=True),
    FrameFault("frame, another camera", another=True),
    FrameFault("frame, blank", starless=True),
    FrameFault("frame, full scale everywhere", flat=1.0),
    FrameFault("frame, a pole in the field", place=FieldLocation.POLE),
)


@dataclass(frozen=True)
class FrameShard:
    """One frame for each fault, for one camera and one of its two chains."""

    camera: str
    chain: str
    seed: int
    number: int


def frame_shards(
    frames: int, seed: int, cameras: tuple[str, ...] = CAMERAS, chains: tuple[str, ...] = CHAINS
) -> list[FrameShard]:
    """Return the shards for at least ``frames`` frames per camera and chain."""
    numbers = range(-(-frames // FRAME_SHARD))
    return [FrameShard(camera, chain, seed, n) for n in numbers for camera in cameras for chain in chains]


class FrameCampaign:
    """Runs frame shards and caches the chains."""

    def __init__(self, stars: StarTable) -> None:
        self._stars = stars
        self._solver_for = lru_cache(maxsize=None)(lambda camera, chain: _solver(setting_of(camera, chain), stars))

    def run(self, shard: FrameShard) -> Verdicts:
        """Score one frame for each fault."""
        counts: Counter[tuple[int, int, str]] = Counter()
        wrong = []
        setting, solve = setting_of(shard.camera, shard.chain), self._solver_for(shard.camera, shard.chain)
        for j, fault in enumerate(FRAME_FAULTS):
            key, k = [shard.seed, _STREAM, CAMERAS.index(shard.camera), shard.number, j], shard.number % len(MODES)
            rng = np.random.default_rng(key)
            profile = shipped_camera(shard.camera)
            attitude = attitude_at(fault.place, profile.camera, rng)
            pixels, truth = faulty_frame(fault, profile, self._stars, attitude, rng)
            result = solve(pixels, MODES[k], prior(setting, MODES[k], attitude, rng))
            verdict = assess(result, truth, profile.camera).verdict
            if result.attitude is not None and (fault.mirrored or fault.starless or fault.flat is not None):
                verdict = Verdict.WRONG
            counts[j, k, str(verdict)] += 1
            if verdict is Verdict.WRONG:
                wrong.append(f"{shard.camera}, {setting.chain}, {fault.title}, {MODES[k].value}; generator {key}")
        return Verdicts(dict(counts), tuple(wrong))


def faulty_frame(
    fault: FrameFault, profile: CameraProfile, stars: StarTable, attitude: Array, rng: np.random.Generator
) -> tuple[Frames, Truth]:
    """Return a frame with the fault, in the image size that the chain expects, and the truth for the camera that
    exposed it."""
    taken_by = shipped_camera(OTHER_CAMERA[profile.name]) if fault.another else profile
    camera, sensor = taken_by.camera, taken_by.sensor
    camera = replace(
        camera, focal_col_px=fault.scale * camera.focal_col_px, focal_row_px=fault.scale * camera.focal_row_px
    )
    size = np.array([camera.columns, camera.rows])
    faint = sensor.faint_limit_mag
    places = rng.uniform((0, 0), size - 1, (fault.false, 2))
    axis = rng.normal(size=3)
    planets = attitude[2] + rng.normal(scale=np.tan(camera.half_diagonal_rad) / 2, size=(fault.planets, 3))
    rendered = render(
        stars.take(np.zeros(0, np.intp)) if fault.starless else stars,
        camera,
        sensor,
        attitude,
        fault.exposure * sensor.exposure_s,
        rng,
        rate_rad_s=fault.rate_rad_s * axis / np.linalg.norm(axis),
        false_stars=[FalseStar(float(c), float(r), float(rng.uniform(faint - 3, faint))) for c, r in places],
        hot_pixels=[
            HotPixel(int(c), int(r), float(rng.uniform(1e3, 1e5)))
            for c, r in rng.integers((0, 0), size, (fault.hot, 2))
        ],
        lights=Lights(planets / np.linalg.norm(planets, axis=1, keepdims=True), rng.uniform(*PLANET_MAG, fault.planets))
        if fault.planets
        else None,
    )
    pixels = rendered.pixels[:, ::-1] if fault.mirrored else rendered.pixels
    if fault.flat is not None:
        pixels = np.full_like(pixels, int(fault.flat * sensor.saturation_dn))
    return _crop_or_pad(pixels, profile), rendered.truth


def _crop_or_pad(pixels: Frames, profile: CameraProfile) -> Frames:
    """Crop the frame, or pad it with its median, to the camera's size. Pixel values are not changed."""
    camera = profile.camera
    if pixels.shape == (camera.rows, camera.columns):
        return np.ascontiguousarray(pixels)
    out = np.full((camera.rows, camera.columns), int(np.median(pixels)), pixels.dtype)
    rows, columns = min(camera.rows, pixels.shape[0]), min(camera.columns, pixels.shape[1])
    out[:rows, :columns] = pixels[:rows, :columns]
    return out


def _solver(setting: Setting, stars: StarTable) -> FrameSolver:
    profile = shipped_camera(setting.camera)
    if setting.chain == reference.NAME:
        sky = reference_sky(setting, profile, stars)
        return lambda pixels, mode, near_icrs: reference.solve_known(
            pixels, profile.camera, profile.sensor, sky, hint=reference_hint(setting, mode, near_icrs)
        )
    chain, works = system(setting.chain), works_of(setting, profile, stars)

    def solve(pixels: Frames, mode: Mode, near_icrs: Array | None) -> SolveResult:
        work = replace(works[mode], hint=None if near_icrs is None else hint_of(mode, near_icrs))
        return onboard.solve(chain, pixels, work)

    return solve


__all__ = ["FRAME_FAULTS", "FRAME_SHARD", "OWN", "FrameCampaign", "FrameShard", "faulty_frame", "frame_shards"]
