"""Which code does the inner loops of detection: numpy, or the same loops compiled where the optional extra ``[fast]`` is installed.

Integer work (filter, thresholds, labels) is the same to the bit; sums of floating-point numbers are added in another order,
so that positions and fluxes of the two agree to 1e-6 px and relative. The choice is made once, when the program starts; a
caller that must repeat an older result names it.
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
from gss.domain.errors import BadInput

AVAILABLE = find_spec("numba") is not None
PLAIN, COMPILED = "numpy", "numba"
CLIP_SIGMA = 3.0
CLIP_ROUNDS = 2

Rows = NDArray[np.intp]


@dataclass(frozen=True)
class Kernels:
    """The loops that take the time. None: the numpy way that stands beside each place of use.

    ``binomial``: frame → filtered frame. ``clip``: (sorted samples, count of each row) → mean and spread. ``above``:
    (filtered frame, thresholds (tile rows, columns), side of a tile) → rows and columns. ``settle``: see ``psf.settled``.
    ``components``: (flat numbers of lit pixels, frame's width) → count and label of each. ``lit``: (frame, threshold) →
    flat numbers.
    """

    name: str = PLAIN
    binomial: Callable[[NDArray[Any]], NDArray[Any]] | None = None
    clip: Callable[[NDArray[Any], Rows], tuple[Array, Array]] | None = None
    above: Callable[[NDArray[Any], NDArray[Any], int], tuple[Rows, Rows]] | None = None
    settle: Callable[..., tuple[Array, Array]] | None = None
    components: Callable[[Rows, int], tuple[int, NDArray[np.int32]]] | None = None
    lit: Callable[[NDArray[Any], float], Rows] | None = None


NUMPY = Kernels()


def kernels(fast: bool | None = None) -> Kernels:
    """``fast`` None: compiled where they can be had; True asks for them, False for numpy."""
    if not (AVAILABLE if fast is None else fast):
        return NUMPY
    if not AVAILABLE:
        raise BadInput(
            "the compiled loops are not installed",
            expected="the extra [fast]",
            hint="pip install 'gss-startracker[fast]'",
        )
    return _compiled()


@lru_cache(maxsize=1)
def _compiled() -> Kernels:
    # Imported at first use: it takes a second that a command that solves nothing should not pay.
    from gss.pipeline import compiled

    return Kernels(
        COMPILED, compiled.binomial, compiled.clip, compiled.above, compiled.settle, compiled.components, compiled.lit
    )
