"""Measure which part of the work takes the time: every compiled loop, and Python between the loops."""

from __future__ import annotations

import statistics
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import fields, replace
from functools import partial, wraps
from time import perf_counter_ns
from typing import Any
from unittest.mock import patch

from gss.pipeline import kernels
from gss.pipeline.chains import reference
from gss.pipeline.detect import find_stars
from gss.pipeline.identify.near import BoundedPrior
from tools.bench_frames import STARS
from tools.bench_identify import PRIOR_OFF_RAD, centroids_of
from tools.bench_scenes import CAMERAS, E_PER_DN, SIGMA_PX, Disturbance, Optics, star_frames, star_lists, visible_stars
from tools.bench_tables import BenchTable, Value

SEED = 77
FALSE_STARS = (0, 10)
PYTHON = "between the loops"
Nanoseconds = defaultdict[str, int]


def profiles(quick: bool) -> list[BenchTable]:
    """Return the time of each loop for lists lost in space and near a known attitude, and for detection in frames."""
    if not kernels.AVAILABLE:
        return []
    spent: Nanoseconds = defaultdict(int)
    rows: list[tuple[str, dict[str, Value]]] = []
    with _clocks_on_loops(spent):
        for optics in CAMERAS:
            for work, calls in _list_calls(optics, 5 if quick else 300):
                rows += _rows(f"{optics.name}, {work}", calls, spent)
        frames = star_frames(3 if quick else 60, STARS, SEED)
        find = partial(find_stars, psf_sigma_px=SIGMA_PX, saturation_dn=255.0, e_per_dn=E_PER_DN, fast=True)
        rows += _rows("detection, 1024 x 512", [partial(find, frame.pixels) for frame in frames], spent)
    conditions = (
        "The lists of the tables above with another seed, and the frames of detection. Mean of all calls but the first; "
        f"'{PYTHON}': everything outside the compiled loops, mostly Python and numpy. The clocks add about 1 µs per loop."
    )
    return [BenchTable("profile", "Profile of the reference chain", conditions, SEED, rows)]


def _list_calls(optics: Optics, count: int) -> Iterator[tuple[str, list[Callable[[], object]]]]:
    """Yield the name of each work and its calls."""
    sky, camera = visible_stars(optics), optics.camera
    known_sky = reference.known_sky(sky, camera, optics.faint_mag)
    for false_stars in FALSE_STARS:
        scenes = star_lists(sky, optics, count, Disturbance(false_stars), SEED)
        solve = partial(reference.solve_centroids, camera=camera, stars=known_sky, fast=True)
        lists = [(centroids_of(scene, optics), BoundedPrior(scene.cam_from_icrs, PRIOR_OFF_RAD)) for scene in scenes]
        yield f"{false_stars} false", [partial(solve, centroids) for centroids, _ in lists]
        yield f"near, {false_stars} false", [partial(solve, centroids, hint=hint) for centroids, hint in lists]


def _rows(work: str, calls: list[Callable[[], object]], spent: Nanoseconds) -> list[tuple[str, dict[str, Value]]]:
    """Return a row for the whole and for each part that takes 1 % or more of it."""
    calls[0]()
    spent.clear()
    totals_us = []
    for call in calls[1:]:
        start = perf_counter_ns()
        call()
        totals_us.append((perf_counter_ns() - start) / 1e3)
    mean_us = statistics.fmean(totals_us)
    parts = {name: ns / 1e3 / len(totals_us) for name, ns in spent.items()}
    parts[PYTHON] = mean_us - sum(parts.values())
    rows: list[tuple[str, dict[str, Value]]] = [
        (work, {"mean_us": mean_us, "median_us": statistics.median(totals_us), "percent": 100.0})
    ]
    for name, us in sorted(parts.items(), key=lambda part: -part[1]):
        if us >= mean_us / 100:
            rows.append((f"{work}: {name}", {"mean_us": us, "percent": 100 * us / mean_us}))
    return rows


@contextmanager
def _clocks_on_loops(spent: Nanoseconds) -> Iterator[None]:
    """Let each loop add its time to ``spent``."""
    compiled = kernels.kernels(True)

    def with_clock(name: str, loop: Callable[..., Any]) -> Callable[..., Any]:
        @wraps(loop)
        def timed(*arguments: Any) -> Any:
            start = perf_counter_ns()
            result = loop(*arguments)
            spent[name] += perf_counter_ns() - start
            return result

        return timed

    def all_with_clocks(loops: Any) -> Any:
        return replace(loops, **{f.name: with_clock(f.name, getattr(loops, f.name)) for f in fields(loops)})

    timed = replace(compiled, frames=all_with_clocks(compiled.frames), lists=all_with_clocks(compiled.lists))
    with patch.object(kernels, "_compiled", lambda: timed):
        yield
