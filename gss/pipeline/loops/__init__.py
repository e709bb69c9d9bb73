"""Compiled loops of the reference solver for lists of stars. Each function is equivalent to the numpy function that it names; tests
compare them. :mod:`gss.pipeline.kernels` imports this package when it is first needed, because numba takes a second to import."""

from __future__ import annotations

from functools import partial

from numba import njit

# A division by zero gives infinity as in numpy, not an exception.
loop = partial(njit, cache=True, error_model="numpy")
