"""Catalogue in the memory of FAR-MST's processor: sin²θ directory of the brightest stars of every field.

A bank in the far-mst format contains the directory. For other formats, the processor builds it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gss.domain.angles import Array
from gss.domain.camera import Camera
from gss.pipeline.identify.pair_directory_stars import brightest_per_field
from gss.skytables.bank import OnboardCatalogue
from gss.skytables.pairs import DistanceTable
from gss.skytables.sin2 import Sin2Directory, indexed, sin2_directory

# Huffman 2006 §5.5.4.
BRIGHTEST = 8


@dataclass(frozen=True)
class FarMstCatalogue:
    """Prepared catalogue. ``icrs``: (n, 3) unit vectors in full precision; ``reduced``: (n,) mask of the stars in the
    directory. All stars are used for confirmation."""

    bank: OnboardCatalogue
    icrs: Array
    reduced: NDArray[np.bool_]
    directory: Sin2Directory

    def __len__(self) -> int:
        return len(self.bank)


def far_mst_catalogue(bank: OnboardCatalogue, camera: Camera, brightest: int = BRIGHTEST) -> FarMstCatalogue:
    """Return the bank's directory, or build it from the bank's reduced catalogue or from the ``brightest`` stars per
    field (0: all stars). Only distances of the bank are used."""
    bank.need_distances()
    icrs = bank.icrs.astype(float)
    icrs = icrs / np.linalg.norm(icrs, axis=1, keepdims=True)
    if bank.tables.sin2 is not None:
        return _as_stored(bank, icrs, bank.tables.sin2)
    reduced = np.ones(len(bank), bool)
    if bank.tables.reduced is not None:
        reduced = bank.tables.reduced.kept
    elif brightest:
        fov_h, fov_v = camera.fov_rad
        reduced = brightest_per_field(icrs, brightness_order(bank), min(fov_h, fov_v) / 2, brightest)
    table = bank.distances
    right_angle = float(np.nextafter(np.float32(np.pi / 2), np.float32(0)))
    # Pairs beyond 90° are omitted. They do not occur in a frame of this camera, and sin² is ambiguous for them.
    keep = np.flatnonzero(reduced[table.first] & reduced[table.second] & (table.distance_rad <= right_angle))
    distances = DistanceTable(
        table.first[keep], table.second[keep], table.distance_rad[keep], table.min_rad, min(table.max_rad, right_angle)
    )
    return FarMstCatalogue(bank, icrs, reduced, sin2_directory(distances, len(bank)))


def _as_stored(bank: OnboardCatalogue, icrs: Array, sin2: NDArray[np.floating]) -> FarMstCatalogue:
    """Return the directory and k-vector stored in the bank."""
    reduced = np.ones(len(bank), bool) if bank.tables.reduced is None else bank.tables.reduced.kept
    first, second = bank.distances.first.astype(np.intp), bank.distances.second.astype(np.intp)
    index = bank.tables.index
    if index is None:
        return FarMstCatalogue(bank, icrs, reduced, indexed(first, second, sin2.astype(float), len(bank)))
    directory = Sin2Directory(first, second, sin2.astype(float), index, len(bank))
    return FarMstCatalogue(bank, icrs, reduced, directory)


def brightness_order(bank: OnboardCatalogue) -> NDArray[np.intp]:
    """Return the (n,) rows, brightest first. A bank without magnitudes is already in this order."""
    if not np.isfinite(bank.v_mag).all():
        return np.arange(len(bank))
    return np.argsort(bank.v_mag, kind="stable")
