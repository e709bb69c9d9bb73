"""Compiled loops of the reference solver, over the pixels of a frame and over lists of stars. Each function is equivalent to
the numpy function that its docstring names; tests compare them. :mod:`gss.pipeline.kernels` imports this package at
first use, because the import of numba takes a second."""

from __future__ import annotations

from functools import partial

import numba

from gss.pipeline.kernels import cache_folder

numba.config.CACHE_DIR = str(cache_folder() or "")
# A division by zero gives infinity as in numpy, not an exception. numba compiles a called loop again for a literal integer, but not
# for np.int64(0).
loop = partial(numba.njit, cache=True, error_model="numpy")
