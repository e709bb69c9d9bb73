"""Selection of the inner loops of detection and identification: numpy, or loops that numba has compiled for this machine.

Both give the same identifications. Integer results of detection (filter, thresholds, labels) are bit-identical.
Floating-point sums are added in a different order, so positions agree to 1e-6 px and fluxes to a relative difference of
1e-6.

Compiling takes more than a minute of processor time, so a frame never waits for it: ``gss compile``, which a server
starts in the background, compiles the loops and marks them as compiled; without this mark the numpy loops are the
default. A caller that must reproduce an earlier result states which loops to use.
"""

from __future__ import annotations

import hashlib
import sys
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from gss.domain.angles import Array
from gss.domain.camera import Camera
from gss.domain.errors import BadInput, StoreDown

AVAILABLE = find_spec("numba") is not None
PLAIN, COMPILED = "numpy", "numba"
CLIP_SIGMA = 3.0
CLIP_ROUNDS = 2

Rows = NDArray[np.intp]


@dataclass(frozen=True)
class ListLoops:
    """Compiled loops that work on lists of stars. ``camera_numbers``: converts a camera to an array. ``find``: see
    ``pyramid.identify_lost``. ``find_near``: see ``near.identify_near``. ``finish``: see ``faint.match_all``."""

    camera_numbers: Callable[[Camera], Array]
    find: Callable[..., tuple[int, int, float, int, bool]]
    find_near: Callable[..., tuple[int, int, float, int, int]]
    finish: Callable[..., tuple[Rows, Rows, Array, Array, Array, float]]


@dataclass(frozen=True)
class Kernels:
    """Time-critical loops. If a loop is None, the calling module uses its numpy implementation.

    ``binomial``: frame → filtered frame. ``clip``: (sorted samples, count of each row) → mean and spread. ``maxima``:
    (filtered frame, thresholds (tile rows, columns), rows per tile) → rows and columns. ``fit``: see
    ``psf.fitted``. ``components``: (flat indices of lit pixels, frame's width) → count and label of each. ``lit``:
    (frame, threshold) → flat indices. ``lists``: see :class:`ListLoops`.
    """

    name: str = PLAIN
    binomial: Callable[[NDArray[Any]], NDArray[Any]] | None = None
    clip: Callable[[NDArray[Any], Rows], tuple[Array, Array]] | None = None
    maxima: Callable[[NDArray[Any], NDArray[Any], int], tuple[Rows, Rows]] | None = None
    fit: Callable[..., tuple[Array, Array, Array, Array]] | None = None
    components: Callable[[Rows, int], tuple[int, NDArray[np.int32]]] | None = None
    lit: Callable[[NDArray[Any], float], Rows] | None = None
    lists: ListLoops | None = None


NUMPY = Kernels()


def kernels(fast: bool | None = None) -> Kernels:
    """Select the loops. ``fast`` None: compiled if :func:`are_compiled`; True: compiled, now if necessary; False: numpy. With True,
    raises BadInput if numba is not installed, and StoreDown if it has no folder for compiled loops."""
    if not (are_compiled() if fast is None else fast):
        return NUMPY
    if not AVAILABLE:
        raise BadInput("numba is not installed", expected="the package numba", hint="run pip install numba")
    compiled_mark()
    return _compiled()


def are_compiled() -> bool:
    """True if ``gss compile`` has compiled the present loops for this processor. False if they cannot be stored."""
    mark = _mark() if AVAILABLE else None
    return mark is not None and mark.exists()


def compiled_mark() -> Path:
    """Return the file that states that the loops are compiled. Its name changes with the loops, numba, Python and processor, and it
    lies beside the compiled loops, so that it is deleted with them. Raises StoreDown if numba can write in no folder."""
    mark = _mark()
    if mark is None:
        raise StoreDown(
            "the compiled loops of the solver cannot be stored",
            expected="a folder that numba can write: __pycache__ of the installed package, or the user's cache folder",
            hint="set NUMBA_CACHE_DIR to a writable folder; the solver is slower until then",
        )
    return mark


@lru_cache(maxsize=1)
def _mark() -> Path | None:
    from llvmlite.binding import get_host_cpu_features, get_host_cpu_name

    try:
        from gss.pipeline.loops.search import find
    except RuntimeError:  # numba found no folder that it can write
        return None
    folder = Path(__file__).parent
    sources = [folder / "compiled.py", *sorted((folder / "loops").glob("*.py"))]
    digest = hashlib.sha256()
    for text in (version("numba"), sys.version, get_host_cpu_name(), get_host_cpu_features().flatten()):
        digest.update(text.encode())
    for source in sources:
        facts = source.stat()  # numba compiles again if one of these changes
        digest.update(f"{facts.st_mtime} {facts.st_size}".encode())
    return Path(cast(Any, find).stats.cache_path) / f"gss-loops-{digest.hexdigest()[:16]}.compiled"


@lru_cache(maxsize=1)
def _compiled() -> Kernels:
    # Imported at first use because the import takes a second and most commands do not need it.
    from gss.pipeline import compiled
    from gss.pipeline.loops.finish import finish
    from gss.pipeline.loops.geometry import camera_numbers
    from gss.pipeline.loops.prior import find_near
    from gss.pipeline.loops.search import find

    return Kernels(
        COMPILED,
        compiled.binomial,
        compiled.clip,
        compiled.maxima,
        compiled.fit,
        compiled.components,
        compiled.lit,
        ListLoops(camera_numbers, find, find_near, finish),
    )
