"""Compare lost-in-space identification of GSS and its peers on the same centroid lists."""

from __future__ import annotations

import logging
import math
import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np

from gss.domain.results import Centroids
from gss.domain.rotation import rotation_from_vector
from gss.instruments.registry import shipped_camera
from gss.pipeline.chains import cubestar, reference
from gss.pipeline.identify.near import BoundedPrior
from gss.pipeline.identify.verify import SkyCatalogue
from gss.skytables.bank import OnboardCatalogue
from gss.skytables.pairs import distance_table_of_units
from tools.bench_scenes import CAMERAS, Array, CentroidList, Disturbance, Optics, star_lists, visible_stars
from tools.bench_tables import BenchTable, Value, spread, timed_ms

SEED = 2025
NOISE_PX = 0.2
FALSE_STARS = {f"{n} false": Disturbance(n) for n in (0, 1, 5, 10, 20)}
DISTURBANCES = FALSE_STARS | {
    "40 % missing, 5 false": Disturbance(5, missing=0.4),
    "50 % missing, 10 false": Disturbance(10, missing=0.5),
    "0.6 px, 5 false": Disturbance(5, noise_px=0.6),
    "focal length +0.5 %, 5 false": Disturbance(5, focal_scale=1.005),
    "focal length −3 %, 5 false": Disturbance(5, focal_scale=0.97),
    "mirrored, 5 false": Disturbance(5, mirrored=True),
    "no star, 20 false": Disturbance(20, no_star=True),
}
MIN_STARS = 4
SLOW_PEER, SLOW_PEER_LISTS, SLOW_PEER_LIMIT_MS = "cedar-solve", 30, 500
"""Peer that needs up to a second for a list that it cannot solve."""
PRIOR_OFF_RAD = float(np.radians(0.5))
Solver = Callable[[CentroidList], tuple[float, Array | None]]
"""Solver of a centroid list. Returns the duration in ms and the (3,) boresight in ICRS, or None without a solution."""


def lost_in_space(quick: bool) -> list[BenchTable]:
    """Return one table for each camera."""
    return [_table(optics, 5 if quick else 300) for optics in CAMERAS]


def near_attitude(quick: bool) -> list[BenchTable]:
    """Return results with a prior attitude off by up to 0.5° (assisted and tracking), with and without false stars."""
    return [_near_table(optics, 5 if quick else 300) for optics in CAMERAS]


def _near_table(optics: Optics, count: int) -> BenchTable:
    sky = visible_stars(optics)
    camera, known_sky = optics.camera, reference.known_sky(sky, optics.camera, optics.faint_mag)
    rows: list[tuple[str, dict[str, Value]]] = []
    for label, disturbance in FALSE_STARS.items():
        rng = np.random.default_rng(SEED + disturbance.false_stars)
        scenes = star_lists(sky, optics, count, disturbance, SEED + disturbance.false_stars)
        answers: list[tuple[float, Array | None]] = []
        for scene in scenes:
            centroids = centroids_of(scene, optics)
            axis = rng.normal(size=3)
            prior = (
                rotation_from_vector(axis / np.linalg.norm(axis) * PRIOR_OFF_RAD * rng.uniform()) @ scene.cam_from_icrs
            )
            hint = BoundedPrior(prior, PRIOR_OFF_RAD)
            duration_ms, result = timed_ms(partial(reference.solve_centroids, centroids, camera, known_sky, hint=hint))
            answers.append((duration_ms, None if result.attitude is None else result.attitude.cam_from_icrs[2]))
        few = sum(scene.true_stars < MIN_STARS for scene in scenes)
        durations = spread([ms for ms, _ in answers[1:]])
        rows.append((f"{label}, reference", durations | _accuracy(answers, scenes, optics) | {"few": few}))
    conditions = (
        f"{count} lists as lost in space; the prior attitude is off by up to {np.degrees(PRIOR_OFF_RAD):g}° about any axis; "
        "identification, attitude and covariance together. If the prior gives no solution, the whole sky is searched."
    )
    return BenchTable("near_attitude", f"Near a known attitude, {optics.name}", conditions, SEED, rows)


def _table(optics: Optics, count: int) -> BenchTable:
    sky = visible_stars(optics)
    solvers: dict[str, Solver] = {"reference": _reference(sky, optics)}
    if optics.name == "cubestar":
        solvers["cubestar"] = _replica(sky, optics)
    skipped: list[str] = []
    for name, make in (("tetra3rs", _tetra3rs), (SLOW_PEER, _cedar)):
        try:
            solvers[name] = make(sky, optics)
        except ImportError:
            skipped.append(f"{name} is not installed")
    rows: list[tuple[str, dict[str, Value]]] = []
    for label, disturbance in DISTURBANCES.items():
        scenes = star_lists(sky, optics, count, disturbance, SEED + disturbance.false_stars)
        rows += _rows(label, scenes, solvers, optics)
    conditions = (
        f"{count} random attitudes for each row; {optics.columns} x {optics.rows} px, no distortion, "
        f"{len(sky)} stars to V {optics.faint_mag}, positions ±{NOISE_PX} px, magnitudes ±0.15, "
        "except as the row states; a mirrored list and a list without stars have no correct solution; "
        f"correct within {np.degrees(optics.tolerance_rad):.2f}°; one thread. "
        f"'few' counts lists with fewer than {MIN_STARS} stars; right_of_solvable: percent of the other lists. "
        f"{SLOW_PEER} gets the first {SLOW_PEER_LISTS} lists, and at most {SLOW_PEER_LIMIT_MS} ms for each."
    )
    return BenchTable("lost_in_space", f"Lost in space, {optics.name}", conditions, SEED, rows, skipped)


def _rows(
    label: str, scenes: list[CentroidList], solvers: dict[str, Solver], optics: Optics
) -> list[tuple[str, dict[str, Value]]]:
    results: dict[str, list[tuple[float, Array | None]]] = {name: [] for name in solvers}
    for solve in solvers.values():
        solve(scenes[0])
    for k, scene in enumerate(scenes):
        for name, solve in solvers.items():
            if name != SLOW_PEER or k < SLOW_PEER_LISTS:
                results[name].append(solve(scene))
    ours_ms = float(np.median([ms for ms, _ in results["reference"]]))
    rows = []
    for name, answers in results.items():
        durations, solved = spread([ms for ms, _ in answers]), scenes[: len(answers)]
        counts: dict[str, Value] = {
            "few": sum(scene.true_stars < MIN_STARS for scene in solved),
            "lists": len(answers),
        }
        ratio: dict[str, Value] = {"time_of_ours": float(durations["median_ms"] or 0) / ours_ms}
        rows.append((f"{label}, {name}", durations | ratio | _accuracy(answers, solved, optics) | counts))
    return rows


def _accuracy(
    answers: list[tuple[float, Array | None]], scenes: list[CentroidList], optics: Optics
) -> dict[str, Value]:
    errors_rad = [
        np.inf if a is None else _angle_rad(a, scene.cam_from_icrs[2])
        for (_, a), scene in zip(answers, scenes, strict=True)
    ]
    right = np.array(errors_rad) <= optics.tolerance_rad
    none = sum(boresight is None for _, boresight in answers)
    solvable = np.array([scene.true_stars >= MIN_STARS for scene in scenes])
    n = len(scenes)
    return {
        "right_percent": 100 * int(right.sum()) / n,
        "right_of_solvable": 100 * float(right[solvable].mean()) if solvable.any() else None,
        "wrong_percent": 100 * (n - none - int(right.sum())) / n,
        "none_percent": 100 * none / n,
        "error_arcsec": float(np.degrees(np.median(np.array(errors_rad)[right])) * 3600) if right.any() else None,
    }


def _angle_rad(a: Array, b: Array) -> float:
    return 2 * float(np.arcsin(min(1.0, float(np.linalg.norm(a - b)) / 2)))


def centroids_of(scene: CentroidList, optics: Optics) -> Centroids:
    centre = np.array([(optics.columns - 1) / 2, (optics.rows - 1) / 2])
    return Centroids.from_pixels(scene.offset_px + centre, 10 ** (-0.4 * scene.magnitude), NOISE_PX)


def _reference(sky: SkyCatalogue, optics: Optics) -> Solver:
    camera = optics.camera
    known_sky = reference.known_sky(sky, camera, optics.faint_mag)

    def solve(scene: CentroidList) -> tuple[float, Array | None]:
        centroids = centroids_of(scene, optics)
        duration_ms, result = timed_ms(lambda: reference.solve_centroids(centroids, camera, known_sky))
        return duration_ms, None if result.attitude is None else result.attitude.cam_from_icrs[2]

    return solve


def _replica(sky: SkyCatalogue, optics: Optics) -> Solver:
    camera = optics.camera
    icrs = sky.icrs.astype(np.float32)
    bank = OnboardCatalogue(sky.hip, icrs, sky.v_mag, distance_table_of_units(icrs, 0.0, camera.diagonal_rad))
    parameters = cubestar.default_parameters(shipped_camera("cubestar"))

    def solve(scene: CentroidList) -> tuple[float, Array | None]:
        centroids = centroids_of(scene, optics)
        duration_ms, result = timed_ms(lambda: cubestar.solve_centroids(centroids, camera, bank, parameters))
        return duration_ms, None if result.attitude is None else result.attitude.cam_from_icrs[2]

    return solve


def _tetra3rs(sky: SkyCatalogue, optics: Optics) -> Solver:
    """Return a tetra3rs solver with the same stars. The peer supports only square pixels, so the rows are stretched."""
    import tetra3rs

    width_deg, height_deg = np.degrees(optics.fov_rad)
    with tempfile.TemporaryDirectory() as folder:
        catalogue = Path(folder) / "stars.bin"
        catalogue.write_bytes(_gaia_records(sky))
        database = tetra3rs.SolverDatabase.generate_from_gaia(
            str(catalogue),
            max_fov_deg=width_deg,
            min_fov_deg=height_deg,
            star_max_magnitude=optics.faint_mag + 0.01,
            epoch_proper_motion_year=None,
        )
    stretch = optics.pitch_row_mm / optics.pitch_col_mm
    camera = tetra3rs.CameraModel(optics.focal_mm / optics.pitch_col_mm, optics.columns, round(optics.rows * stretch))

    def solve(scene: CentroidList) -> tuple[float, Array | None]:
        stars = np.column_stack([scene.offset_px * [1.0, stretch], 10 ** (-0.4 * scene.magnitude)])
        duration_ms, result = timed_ms(
            lambda: database.solve_from_centroids(
                stars, camera_model=camera, fov_max_error_deg=0.02 * width_deg, solve_timeout_ms=1000
            )
        )
        if not result:
            return duration_ms, None
        ra_rad, dec_rad = np.radians([result.ra_deg, result.dec_deg])  # type: ignore[union-attr]  # its truth says so
        flat = np.cos(dec_rad)
        return duration_ms, np.array([flat * np.cos(ra_rad), flat * np.sin(ra_rad), np.sin(dec_rad)])

    return solve


def _cedar(sky: SkyCatalogue, optics: Optics) -> Solver:
    """Return a cedar-solve solver with the same stars. The peer supports only square pixels, so the rows are
    stretched."""
    import tetra3  # type: ignore[import-not-found, unused-ignore]  # an optional peer

    vars(np).setdefault("math", math)  # cedar-solve 0.5.1 uses np.math, which numpy 2 does not have
    logging.getLogger("tetra3.Tetra3").setLevel(logging.ERROR)
    width_deg, height_deg = (float(a) for a in np.degrees(optics.fov_rad))
    peer = tetra3.Tetra3(load_database=None)
    with tempfile.TemporaryDirectory() as folder:
        catalogue, database = Path(folder) / "hip_main.dat", Path(folder) / "stars.npz"
        catalogue.write_text(_hipparcos_lines(sky))
        peer.generate_database(
            star_catalog=str(catalogue),
            save_as=str(database),
            max_fov=width_deg,
            min_fov=height_deg,
            star_max_magnitude=optics.faint_mag + 0.01,
            epoch_proper_motion=None,
        )
        peer = tetra3.Tetra3(load_database=None)
        peer.load_database(str(database))
    stretch = optics.pitch_row_mm / optics.pitch_col_mm
    size = optics.rows * stretch, optics.columns
    centre = np.array([size[0] / 2, size[1] / 2])

    def solve(scene: CentroidList) -> tuple[float, Array | None]:
        brightest = np.argsort(scene.magnitude, kind="stable")
        positions = scene.offset_px[brightest][:, ::-1] * [stretch, 1.0] + centre
        duration_ms, result = timed_ms(
            lambda: peer.solve_from_centroids(
                positions,
                size,
                fov_estimate=width_deg,
                fov_max_error=0.02 * width_deg,
                solve_timeout=SLOW_PEER_LIMIT_MS,
            )
        )
        if result.get("RA") is None:
            return duration_ms, None
        ra_rad, dec_rad = np.radians([result["RA"], result["Dec"]])
        flat = np.cos(dec_rad)
        return duration_ms, np.array([flat * np.cos(ra_rad), flat * np.sin(ra_rad), np.sin(dec_rad)])

    return solve


def _hipparcos_lines(sky: SkyCatalogue) -> str:
    """Return the stars in the format of the Hipparcos main catalogue, with the columns that the peer reads. Proper
    motion is zero, because positions are already at the epoch."""
    x, y, z = sky.icrs.T
    ra_deg, dec_deg = np.degrees(np.arctan2(y, x)) % 360, np.degrees(np.arcsin(z))
    lines = []
    for hip, ra, dec, v_mag in zip(sky.hip, ra_deg, dec_deg, sky.v_mag, strict=True):
        fields = [""] * 20
        fields[0], fields[1], fields[5] = "H", str(int(hip)), f"{v_mag:.2f}"
        fields[8], fields[9], fields[12], fields[13] = f"{ra:.8f}", f"{dec:.8f}", "0.0", "0.0"
        lines.append("|".join(fields))
    return "\n".join(lines) + "\n"


def _gaia_records(sky: SkyCatalogue) -> bytes:
    """Return the stars in the file format that the peer reads. Proper motion is zero, because positions are already at
    the epoch."""
    fields = [("id", "<i8"), ("ra", "<f8"), ("dec", "<f8"), ("mag", "<f4"), ("pm_ra", "<f4"), ("pm_dec", "<f4")]
    records = np.zeros(len(sky), np.dtype(fields))
    x, y, z = sky.icrs.T
    records["id"], records["mag"] = sky.hip, sky.v_mag
    records["ra"], records["dec"] = np.degrees(np.arctan2(y, x)) % 360, np.degrees(np.arcsin(z))
    return b"GDR3" + (1).to_bytes(4, "little") + len(records).to_bytes(8, "little") + records.tobytes()
