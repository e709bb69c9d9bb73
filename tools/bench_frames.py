"""Measure image processing: rendering, complete chains, and detection and centroids compared with the Cramér–Rao bound
and with peers."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gss.catalogue_tools.onboard import decode, encode
from gss.catalogue_tools.sources.hipparcos import FAINTEST_V_MAG, load_stars, propagate
from gss.domain.camera_profile import CameraProfile
from gss.domain.results import SolveResult, Truth, Verdict
from gss.domain.rotation import matrix_from_quaternion, random_quaternion
from gss.instruments.registry import shipped_camera
from gss.pipeline import kernels
from gss.pipeline.chains import cubestar, reference
from gss.pipeline.detect import find_stars
from gss.pipeline.identify.verify import SkyCatalogue
from gss.pipeline.render import render
from gss.pipeline.score import assess
from gss.skytables.bank import OnboardCatalogue
from gss.skytables.pairs import distance_table
from tools.bench_scenes import E_PER_DN, EPOCH_JYEAR, SIGMA_PX, Array, StarFrame, star_frames
from tools.bench_tables import BenchTable, Value, repeated_ms, spread, timed_ms

FIND_SEED, CHAIN_SEED, DRAW_SEED = 554, 11, 5
STARS = 20
FOUND_WITHIN_PX = 1.5
DEEPER_MAG = 2.5
Finder = Callable[[NDArray[np.uint8]], Array]


def rendering(quick: bool) -> list[BenchTable]:
    """Return the time to render one frame."""
    rows: list[tuple[str, dict[str, Value]]] = []
    for name in ("cubestar", "sunsat"):
        profile = shipped_camera(name)
        stars = propagate(load_stars(_drawn_to_mag(profile)), EPOCH_JYEAR)
        rng = np.random.default_rng(DRAW_SEED)

        def draw(profile: CameraProfile = profile, stars: Any = stars, rng: np.random.Generator = rng) -> object:
            pose = matrix_from_quaternion(random_quaternion(rng))
            return render(stars, profile.camera, profile.sensor, pose, profile.sensor.exposure_s, rng)

        size = f"{profile.camera.columns} x {profile.camera.rows}"
        rows.append((f"{name}, {size}", spread(repeated_ms(draw, 5 if quick else 60))))
    conditions = (
        f"Random attitudes, stars to {DEEPER_MAG} mag below the camera's limit (V 8 at most), all noise, no motion."
    )
    return [BenchTable("render", "Drawing a frame", conditions, DRAW_SEED, rows)]


def detection(quick: bool) -> list[BenchTable]:
    """Return detection and centroid results of all finders on the same frames. The finders alternate, so the load of
    the machine affects all finders equally."""
    frames = star_frames(3 if quick else 60, STARS, FIND_SEED)
    finders: dict[str, Finder] = {
        "reference, known camera": _reference_finder(SIGMA_PX, fast=False),
        "reference, unknown width": _reference_finder(None, fast=False),
    }
    skipped: list[str] = []
    if kernels.AVAILABLE:
        finders["reference [fast], known camera"] = _reference_finder(SIGMA_PX, fast=True)
    else:
        skipped.append("the extra [fast] is not installed")
    for peer in (_sep_finders, _tetra3rs_finders):
        try:
            finders |= peer()
        except ImportError as error:
            skipped.append(f"{error.name} is not installed")
    durations_ms: dict[str, list[float]] = {name: [] for name in finders}
    centroids: dict[str, list[Array]] = {name: [] for name in finders}
    for finder in finders.values():
        finder(frames[0].pixels)
    for frame in frames:
        for name, finder in finders.items():
            duration_ms, positions = timed_ms(partial(finder, frame.pixels))
            durations_ms[name].append(duration_ms)
            centroids[name].append(positions)
    ours_ms = float(np.median(durations_ms["reference, known camera"]))
    rows = [
        (
            name,
            spread(durations_ms[name])
            | {"time_of_ours": float(np.median(durations_ms[name])) / ours_ms}
            | _accuracy(frames, centroids[name]),
        )
        for name in finders
    ]
    conditions = (
        f"{len(frames)} frames of 1024 x 512 px, 8 bits, {STARS} stars that cover a range of 3 mag, σ {SIGMA_PX:g} px, "
        f"{E_PER_DN:g} e/DN, read-out 40 e, dark 80 e, drawn by a separate program instead of GSS's renderer. "
        "A star counts as detected within "
        f"{FOUND_WITHIN_PX} px; rms per axis. "
        "The bound is the Cramér–Rao bound for known flux and width."
    )
    return [BenchTable("centroid", "Detection and centroids", conditions, FIND_SEED, rows, skipped)]


def _reference_finder(sigma_px: float | None, *, fast: bool) -> Finder:
    def find(pixels: NDArray[np.uint8]) -> Array:
        if sigma_px is None:
            return find_stars(pixels, fast=fast).centroids.pixels
        detections = find_stars(pixels, psf_sigma_px=sigma_px, saturation_dn=255.0, e_per_dn=E_PER_DN, fast=fast)
        return detections.centroids.pixels

    return find


def _sep_finders() -> dict[str, Finder]:
    import sep  # type: ignore[import-not-found, unused-ignore]  # an optional peer

    def extract(pixels: NDArray[np.uint8]) -> tuple[Any, Any]:
        image = pixels.astype(np.float32)
        background = sep.Background(image)
        background.subfrom(image)
        return image, sep.extract(image, 5.0, err=background.globalrms, minarea=3)

    def moments(pixels: NDArray[np.uint8]) -> Array:
        _, stars = extract(pixels)
        return np.column_stack([stars["x"], stars["y"]])

    def windowed(pixels: NDArray[np.uint8]) -> Array:
        image, stars = extract(pixels)
        col, row, _ = sep.winpos(image, stars["x"], stars["y"], np.full(len(stars), SIGMA_PX))
        return np.column_stack([col, row])

    return {"sep, 5 σ": moments, "sep, 5 σ, winpos": windowed}


def _tetra3rs_finders() -> dict[str, Finder]:
    import tetra3rs

    def positions(pixels: NDArray[np.uint8], detections: Any) -> Array:
        rows, columns = pixels.shape
        middle = columns / 2 - 0.5, rows / 2 - 0.5
        return np.array([(c.x + middle[0], c.y + middle[1]) for c in detections.centroids], float).reshape(-1, 2)

    return {
        "tetra3rs": lambda pixels: positions(pixels, tetra3rs.extract_centroids(pixels, threads=1)),
        "tetra3rs, fast": lambda pixels: positions(pixels, tetra3rs.extract_centroids_fast(pixels, threads=1)),
    }


def _accuracy(frames: list[StarFrame], centroids: list[Array]) -> dict[str, Value]:
    errors, bounds, false = [], [], 0
    for frame, positions in zip(frames, centroids, strict=True):
        used: set[int] = set()
        for position, bound_px in zip(frame.positions, frame.bound_px, strict=True):
            offsets = positions - position
            nearest = int(np.argmin(np.hypot(*offsets.T))) if len(positions) else -1
            if nearest >= 0 and np.hypot(*offsets[nearest]) < FOUND_WITHIN_PX:
                used.add(nearest)
                errors.append(offsets[nearest])
                bounds.append(bound_px)
        false += len(positions) - len(used)
    rms_px = float(np.sqrt(np.mean(np.square(errors)))) if errors else float("nan")
    bound_rms_px = float(np.sqrt(np.mean(np.square(bounds)))) if bounds else float("nan")
    return {
        "rms_px": rms_px,
        "bound_px": bound_rms_px,
        "rms_of_bound": rms_px / bound_rms_px,
        "found_percent": 100 * len(errors) / (STARS * len(frames)),
        "false": false,
    }


def chains(quick: bool) -> list[BenchTable]:
    """Return results of both chains from pixels to attitude on the same frames."""
    profile = shipped_camera("cubestar")
    bank, sky, parameters = _bank(profile), _known_sky(profile), cubestar.default_parameters(profile)
    loops = {"": False} | ({" [fast]": True} if kernels.AVAILABLE else {})
    results: dict[str, list[tuple[float, Verdict]]] = {n + f: [] for n in ("cubestar", "reference") for f in loops}
    for pixels, truth in frames_of(profile, 3 if quick else 200):
        solves: dict[str, Callable[[], SolveResult]] = {}
        for suffix, fast in loops.items():
            ours = partial(cubestar.solve, pixels, profile.camera, bank, parameters, fast=fast)
            free = partial(reference.solve_known, pixels, profile.camera, profile.sensor, sky, fast=fast)
            solves |= {"cubestar" + suffix: ours, "reference" + suffix: free}
        for name, solve in solves.items():
            if not results[name]:
                solve()
            duration_ms, result = timed_ms(solve)
            results[name].append((duration_ms, assess(result, truth, profile.camera).verdict))
    rows = [(name, spread([ms for ms, _ in runs]) | _verdicts([v for _, v in runs])) for name, runs in results.items()]
    conditions = (
        f"{len(results['cubestar'])} frames of the CubeStar camera (1024 x 512 px, its distortion), GSS's renderer, "
        f"random attitudes, stars to {DEEPER_MAG} mag below the limit of 3.8; lost in space, bank through the on-board format."
    )
    return [BenchTable("chain", "From pixels to attitude", conditions, CHAIN_SEED, rows)]


def frames_of(profile: CameraProfile, count: int) -> Iterator[tuple[NDArray[Any], Truth]]:
    stars = propagate(load_stars(_drawn_to_mag(profile)), EPOCH_JYEAR)
    rng = np.random.default_rng(CHAIN_SEED)
    for _ in range(count):
        pose = matrix_from_quaternion(random_quaternion(rng))
        drawn = render(stars, profile.camera, profile.sensor, pose, profile.sensor.exposure_s, rng)
        yield drawn.pixels, drawn.truth


def _drawn_to_mag(profile: CameraProfile) -> float:
    return min(profile.sensor.faint_limit_mag + DEEPER_MAG, FAINTEST_V_MAG)


def _bank(profile: CameraProfile) -> OnboardCatalogue:
    stars = propagate(load_stars(profile.sensor.faint_limit_mag), EPOCH_JYEAR)
    return decode(
        encode(stars, distance_table(stars, 0.0, profile.camera.diagonal_rad), "cubestar", profile.name), stars.hip
    )


def _known_sky(profile: CameraProfile) -> reference.KnownSky:
    stars = propagate(load_stars(_drawn_to_mag(profile)), EPOCH_JYEAR)
    stars = stars.brighter_than(_drawn_to_mag(profile))
    sky = SkyCatalogue(stars.hip, stars.icrs, stars.v_mag)
    return reference.known_sky(sky, profile.camera, profile.sensor.faint_limit_mag)


def _verdicts(verdicts: list[Verdict]) -> dict[str, Value]:
    return {
        "correct": verdicts.count(Verdict.CORRECT),
        "imprecise": verdicts.count(Verdict.IMPRECISE),
        "wrong": verdicts.count(Verdict.WRONG),
        "none": verdicts.count(Verdict.NONE),
    }
