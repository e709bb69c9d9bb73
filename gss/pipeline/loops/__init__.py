"""Compiled loops of the reference solver for lists of stars. Each function is equivalent to the numpy function that its
docstring names; tests compare them. :mod:`gss.pipeline.kernels` imports this package at first use, because the import
of numba takes a second."""

from __future__ import annotations

from functools import partial

from numba import njit

# A division by zero gives infinity as in numpy, not an exception.
loop = partial(njit, cache=True, error_model="numpy")
