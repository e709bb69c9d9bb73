"""Selection of the inner loops of detection and identification: numpy, or loops that numba has compiled for this machine.

Both give the same identifications. Integer results of detection (filter, thresholds, labels) are bit-identical.
Floating-point sums are added in a different order, so positions agree to 1e-6 px and fluxes to a relative difference of
1e-6.

Compiling takes more than a minute of processor time, so a frame never waits for it: ``gss compile``, which a server
starts in the background, compiles the loops and marks them as compiled; without this mark the numpy loops are the
default. A caller that must reproduce an earlier result states which loops to use.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import re
import sys
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from gss.domain.angles import Array
from gss.domain.camera import Camera
from gss.domain.errors import BadInput, StoreDown
from gss.pipeline.small import Rows

if TYPE_CHECKING:
    from gss.domain.results import Centroids
    from gss.pipeline.identify.focal_census import CensusField
    from gss.pipeline.identify.verify import MeasuredArrays

AVAILABLE = find_spec("numba") is not None
PLAIN, COMPILED = "numpy", "numba"
LOOPS = Path(__file__).parent / "loops"
IMPORTED = re.compile(r"^from gss\.([\w.]+) import", re.MULTILINE)
FOLDER, MARK = "gss-loops-", "compiled"
USERS_FOLDER = "~/.cache/gss"


@dataclass(frozen=True)
class ListLoops:
    """Compiled loops that work on lists of stars. ``camera_numbers``: converts a camera to an array. ``measured``: see
    ``verify._measured``. ``find``: see ``pyramid.identify_lost``. ``find_near``: see ``near.identify_near``. ``finish``: see
    ``faint.match_all``. ``mirror_miss_rad``: see ``soundness._mirror_miss_rad``. ``count_coinciding``, ``count_matches``: see
    the functions of ``focal_census``. ``extended``: see ``baselines.extended``. ``predictional_fit``: see
    ``predictional.predictional_fit``. ``supporters``: see ``neighbour_pattern.supporters``."""

    camera_numbers: Callable[[Camera], Array]
    measured: Callable[[Camera, Centroids], MeasuredArrays]
    find: Callable[..., tuple[int, int, float, int, bool]]
    find_near: Callable[..., tuple[int, int, float, int, int]]
    finish: Callable[..., tuple[Rows, Rows, Array, Array, Array, float]]
    mirror_miss_rad: Callable[[Array, Array], float]
    count_coinciding: Callable[[Array, Rows, Array, Rows, Array, Camera, float], int]
    count_matches: Callable[[CensusField, Rows, Array, tuple[float, ...]], NDArray[np.int64]]
    extended: Callable[[Rows, tuple[Any, ...]], Rows]
    predictional_fit: Callable[..., tuple[Array, Rows, Rows, int] | None]
    supporters: Callable[..., Rows]


@dataclass(frozen=True)
class FrameLoops:
    """Compiled loops over the pixels of a frame. ``binomial``: see ``peaks._binomial_sum``. ``tile_samples``, ``clip``,
    ``smooth_mesh``, ``residuals``: see the functions of ``background``. ``significant``, ``sky_of``, ``single_pixels``: see
    ``peaks``. ``separate``, ``sizes``: see ``detect``. ``measure``: see ``psf.measure_stars``. ``lit``: (frame, threshold)
    → flat indices of lit pixels. ``components``: (flat indices, frame's width) → count and label of each. ``trail_sums``: see
    ``streaks.fit_sums``."""

    binomial: Callable[[NDArray[Any]], NDArray[Any]]
    tile_samples: Callable[[NDArray[Any], int, int], NDArray[Any]]
    clip: Callable[[NDArray[Any], Rows], tuple[Array, Array]]
    smooth_mesh: Callable[[Array, Array], tuple[Array, Array]]
    residuals: Callable[[NDArray[Any], Array, int, int], Array]
    significant: Callable[..., tuple[Rows, Rows, Array]]
    sky_of: Callable[..., tuple[Array, Array]]
    single_pixels: Callable[..., NDArray[np.bool_]]
    separate: Callable[..., Rows]
    sizes: Callable[..., tuple[float, float]]
    measure: Callable[..., tuple[Any, ...]]
    lit: Callable[[NDArray[Any], float], Rows]
    components: Callable[[Rows, int], tuple[int, NDArray[np.int32]]]
    trail_sums: Callable[..., Any]


@dataclass(frozen=True)
class Kernels:
    """Time-critical loops. If a group of loops is None, the calling module uses its numpy implementation."""

    name: str = PLAIN
    frames: FrameLoops | None = None
    lists: ListLoops | None = None


NUMPY = Kernels()


def kernels(fast: bool | None = None) -> Kernels:
    """Select the loops. ``fast`` None: compiled if :func:`are_compiled`; True: compiled, now if necessary; False: numpy. With True,
    raises BadInput if numba is not installed, and StoreDown if it has no folder for compiled loops."""
    return _compiled() if (are_compiled() if fast is None else fast) else NUMPY


def are_compiled() -> bool:
    """True if ``gss compile`` has compiled the present loops for this processor, also if the mark is deleted after this
    process has seen it. False if they cannot be stored."""
    folder = cache_folder() if AVAILABLE else None
    if folder is None:
        return False
    try:
        _require_mark(folder)
    except OSError:
        return False
    return True


@lru_cache(maxsize=1)
def _require_mark(folder: Path) -> None:
    """Raise OSError if the loops are not marked as compiled. Only success is cached, so that a solution needs no access to
    the disk after this process has seen the mark."""
    (folder / MARK).stat()


def compiled_mark() -> Path:
    """Return the file that states that the loops are compiled. It lies beside the compiled loops, so that it is deleted
    with them. Raises StoreDown if there is no folder for compiled loops."""
    folder = cache_folder()
    if folder is None:
        raise StoreDown(
            "the compiled loops of the solver cannot be stored",
            expected="a writable folder: __pycache__ of the installed package, or the user's cache folder",
            hint="set NUMBA_CACHE_DIR to a writable folder; the solver is slower until then",
        )
    return folder / MARK


@lru_cache(maxsize=1)
def cache_folder() -> Path | None:
    """Return the folder of the compiled loops, or None if none can be written.

    Its name changes with the place of the package, the processor, Python, numba, the loops, and the modules from which
    they import constants. numba itself compiles a loop again only if the loop's own file has another time or size, so
    that loops of an earlier version would remain after an update.
    """
    from llvmlite.binding import get_host_cpu_features, get_host_cpu_name

    digest = hashlib.sha256()
    for text in (str(LOOPS), version("numba"), sys.version, get_host_cpu_name(), get_host_cpu_features().flatten()):
        digest.update(text.encode())
    for source in _sources():
        digest.update(source.read_bytes())
    chosen = os.environ.get("NUMBA_CACHE_DIR")
    parents = [Path(chosen)] if chosen else [LOOPS / "__pycache__", Path(USERS_FOLDER)]
    for parent in parents:
        with contextlib.suppress(OSError, RuntimeError):  # RuntimeError: the user has no home folder
            folder = parent.expanduser() / f"{FOLDER}{digest.hexdigest()[:16]}"
            folder.mkdir(parents=True, exist_ok=True)
            if os.access(folder, os.W_OK):
                return folder
    return None


def _sources() -> list[Path]:
    """Return the loops, and the modules from which they import."""
    loops = sorted(LOOPS.glob("*.py"))
    names = {name for source in loops for name in IMPORTED.findall(source.read_text("utf-8"))}
    package = Path(__file__).parents[1]
    modules = (package.joinpath(*name.split(".")).with_suffix(".py") for name in sorted(names))
    return loops + [module for module in modules if module.parent != LOOPS and module.exists()]


@lru_cache(maxsize=1)
def _compiled() -> Kernels:
    if not AVAILABLE:
        raise BadInput("numba is not installed", expected="the package numba", hint="run pip install numba")
    compiled_mark()
    # Imported at first use because the import takes a second and most commands do not need it.
    from gss.pipeline.loops import background, peaks, pixels, predictional, stamps, trails
    from gss.pipeline.loops.census import count_coinciding, count_matches
    from gss.pipeline.loops.figures import extended
    from gss.pipeline.loops.finish import finish
    from gss.pipeline.loops.geometry import camera_numbers, measured, mirror_miss_rad
    from gss.pipeline.loops.prior import find_near
    from gss.pipeline.loops.search import find
    from gss.pipeline.loops.supporters import supporters

    frames = FrameLoops(
        pixels.binomial,
        background.tile_samples,
        background.clip,
        background.smooth_mesh,
        background.residuals,
        peaks.significant,
        peaks.sky_of,
        peaks.single_pixels,
        stamps.separate,
        stamps.sizes,
        stamps.measure,
        pixels.lit,
        pixels.components,
        trails.sums,
    )
    lists = ListLoops(
        camera_numbers,
        measured,
        find,
        find_near,
        finish,
        mirror_miss_rad,
        count_coinciding,
        count_matches,
        extended,
        predictional.fit,
        supporters,
    )
    return Kernels(COMPILED, frames, lists)
