"""Measure catalogue building: distance table, envelope, complete builds, pointing statistics."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from datetime import UTC, datetime
from functools import partial

import numpy as np

from gss.catalogue_tools.build import build, preview
from gss.catalogue_tools.envelope.attitude import AttitudeLimits
from gss.catalogue_tools.envelope.envelope import WholeSky
from gss.catalogue_tools.envelope.field import FieldShape
from gss.catalogue_tools.request import BuildRequest, ElementsOrbit
from gss.catalogue_tools.selection.quality import assess
from gss.catalogue_tools.selection.selection import SelectionRules
from gss.catalogue_tools.sources.hipparcos import load_stars, propagate
from gss.instruments.registry import shipped_camera
from gss.skytables.pairs import distance_table
from tools.bench_scenes import EPOCH_JYEAR
from tools.bench_tables import BenchTable, Value, repeated_ms, spread, timed_ms

SEED = 1
START = datetime(2026, 12, 1, tzinfo=UTC)


def _deg(*values: float) -> tuple[float, float]:
    low, high = (float(np.radians(v)) for v in values)
    return low, high


SUNSAT_YEAR = BuildRequest(
    shipped_camera("sunsat"),
    "sunsat",
    SelectionRules(6.0, 2.5, float(np.radians(0.25))),
    orbit=ElementsOrbit(_deg(97, 97), _deg(0, 360)),
    attitude=AttitudeLimits("sunsat", _deg(-10, 10), _deg(-5, 5), _deg(130, 140)),
    start=START,
    days=365.0,
)
SUNSAT_FORTNIGHT = BuildRequest(
    shipped_camera("sunsat"),
    "sunsat",
    SUNSAT_YEAR.rules,
    orbit=ElementsOrbit(_deg(97, 97), _deg(133, 149)),
    attitude=SUNSAT_YEAR.attitude,
    start=START,
    seed=SEED,
)
CUBESTAR_SKY = BuildRequest(
    shipped_camera("cubestar"), "cubestar", SelectionRules(3.8), pair_max_rad=float(np.radians(43)), seed=SEED
)


def catalogues(quick: bool) -> list[BenchTable]:
    """Return times of the catalogue tools."""
    times = 1 if quick else 15
    stars = load_stars()
    bright = propagate(load_stars(6.0), EPOCH_JYEAR)
    far_rad = float(np.radians(13.9))
    rows: list[tuple[str, dict[str, Value]]] = []
    pairs = len(distance_table(bright, 0.0, far_rad))
    durations = repeated_ms(lambda: distance_table(bright, 0.0, far_rad), times)
    rows.append(("distance table, V < 6 within 13.9°", spread(durations) | {"stars": len(bright), "pairs": pairs}))
    preview_result = preview(SUNSAT_YEAR, stars)
    durations = repeated_ms(lambda: preview(SUNSAT_YEAR, stars), times)
    rows.append(
        (
            "Sunsat, a year: envelope, selection, map",
            spread(durations) | {"stars": len(preview_result.selection.kept), "pairs": preview_result.pairs},
        )
    )
    for label, request in (
        ("full build, Sunsat, 14 days", SUNSAT_FORTNIGHT),
        ("full build, CubeStar, whole sky", CUBESTAR_SKY),
    ):
        built = build(request, stars)
        durations = repeated_ms(partial(build, request, stars), times)
        rows.append((label, spread(durations) | {"stars": len(built.stars), "pairs": len(built.distances)}))
    rows.append(_pointings(1_000 if quick else 1_000_000))
    conditions = (
        "GSS's Hipparcos stars, loaded in advance. Distance table: all pairs from zero distance. "
        "Year: inclination 97°, every node, roll ±10°, pitch ±5°, yaw 130–140°, V 2.5–6, no doubles; number of pairs estimated. "
        "Full builds include image, manifest and 30 000 pointings."
    )
    return [BenchTable("catalogue", "Catalogue tools", conditions, SEED, rows)]


def _pointings(count: int) -> tuple[str, dict[str, Value]]:
    shape = FieldShape(shipped_camera("cubestar").camera)
    unit = propagate(load_stars(3.8), EPOCH_JYEAR).icrs
    with ThreadPoolExecutor(2) as pool:
        duration_ms, quality = timed_ms(
            lambda: assess(unit, WholeSky(shape), shape, count, np.random.default_rng(SEED), each=pool.map)
        )
    return f"{count:,} pointings of CubeStar, V ≤ 3.8", {
        "median_ms": duration_ms,
        "stars": len(unit),
        "mean_stars": quality.mean,
        "fewer_than_3_percent": 100 * quality.p_fewer_than(3),
    }
