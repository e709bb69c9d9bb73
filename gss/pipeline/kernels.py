"""Selection of the inner loops of detection and identification: numpy, or compiled loops if the extra ``[fast]`` is installed.

Identification gives the same answers either way. Integer results of detection (filter, thresholds, labels) are
bit-identical; floating-point sums are added in a different order, so positions agree to 1e-6 px and fluxes to 1e-6 relative.
The default is fixed when the program starts; a caller that must reproduce an older result selects explicitly.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from importlib.util import find_spec
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gss.domain.angles import Array
from gss.domain.camera import Camera
from gss.domain.errors import BadInput

AVAILABLE = find_spec("numba") is not None
PLAIN, COMPILED = "numpy", "numba"
CLIP_SIGMA = 3.0
CLIP_ROUNDS = 2

Rows = NDArray[np.intp]


@dataclass(frozen=True)
class ListLoops:
    """The loops for lists of stars. ``camera_numbers``: a camera as an array. ``find``: see ``pyramid.identify_lost``.
    ``find_near``: see ``near.identify_near``. ``finish``: see ``faint.match_all``."""

    camera_numbers: Callable[[Camera], Array]
    find: Callable[..., tuple[int, int, float, int, bool]]
    find_near: Callable[..., tuple[int, int, float, int, int]]
    finish: Callable[..., tuple[Rows, Rows, Array, Array, Array, float]]


@dataclass(frozen=True)
class Kernels:
    """The time-critical loops. None: use the numpy implementation next to each call.

    ``binomial``: frame → filtered frame. ``clip``: (sorted samples, count of each row) → mean and spread. ``above``:
    (filtered frame, thresholds (tile rows, columns), side of a tile) → rows and columns. ``settle``: see ``psf.settled``.
    ``components``: (flat indices of lit pixels, frame's width) → count and label of each. ``lit``: (frame, threshold) →
    flat indices. ``lists``: see :class:`ListLoops`.
    """

    name: str = PLAIN
    binomial: Callable[[NDArray[Any]], NDArray[Any]] | None = None
    clip: Callable[[NDArray[Any], Rows], tuple[Array, Array]] | None = None
    above: Callable[[NDArray[Any], NDArray[Any], int], tuple[Rows, Rows]] | None = None
    settle: Callable[..., tuple[Array, Array]] | None = None
    components: Callable[[Rows, int], tuple[int, NDArray[np.int32]]] | None = None
    lit: Callable[[NDArray[Any], float], Rows] | None = None
    lists: ListLoops | None = None


NUMPY = Kernels()


def kernels(fast: bool | None = None) -> Kernels:
    """Select the loops. ``fast`` None: compiled if available; True: compiled, :class:`BadInput` if not installed; False: numpy."""
    if not (AVAILABLE if fast is None else fast):
        return NUMPY
    if not AVAILABLE:
        raise BadInput(
            "the compiled loops are not installed",
            expected="the extra [fast]",
            hint="run pip install 'gss-startracker[fast]'",
        )
    return _compiled()


@lru_cache(maxsize=1)
def _compiled() -> Kernels:
    # Imported at first use because it takes a second, which commands that solve nothing should not wait for.
    from gss.pipeline import compiled
    from gss.pipeline.loops.finish import finish
    from gss.pipeline.loops.geometry import camera_numbers
    from gss.pipeline.loops.prior import find_near
    from gss.pipeline.loops.search import find

    return Kernels(
        COMPILED,
        compiled.binomial,
        compiled.clip,
        compiled.above,
        compiled.settle,
        compiled.components,
        compiled.lit,
        ListLoops(camera_numbers, find, find_near, finish),
    )
