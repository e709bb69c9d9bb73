"""Checks of a star list and its pairs, before encoding (BadInput) and after decoding (CorruptData)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gss.catalogue_tools.formats.layout import BankFormat
from gss.domain.errors import BadInput, CorruptData
from gss.domain.stars import StarTable
from gss.skytables.pairs import DistanceTable

NORM_TOLERANCE = 1e-5


def check_stars(fmt: BankFormat, stars: StarTable) -> None:
    if len(stars) > fmt.most_stars:
        raise BadInput(
            f"too many stars for the {fmt.name} format",
            expected=f"at most {fmt.most_stars}",
            got=str(len(stars)),
            hint="use a brighter magnitude limit or a smaller envelope",
        )
    if len(stars) and not np.all(np.abs(np.linalg.norm(stars.icrs, axis=1) - 1) < NORM_TOLERANCE):
        raise BadInput("a star's direction is not a unit vector", expected="length 1", got=f"row {_worst(stars.icrs)}")


def check_pairs(fmt: BankFormat, stars: int, distances: DistanceTable) -> None:
    d = np.asarray(distances.distance_rad, float)
    if not len(d):
        return
    ends = np.stack([distances.first, distances.second])
    if ends.min() < 0 or ends.max() >= stars:
        raise BadInput(
            "a pair refers to a star that is not in the list", expected=f"0 to {stars - 1}", got=str(ends.max())
        )
    largest = float(d.max()) if np.isfinite(d).all() else np.inf
    if largest > fmt.largest_pair_rad:
        raise BadInput(
            f"a distance is too large for the {fmt.name} format",
            expected=f"at most {np.degrees(fmt.largest_pair_rad):.2f}°",
            got=f"{np.degrees(largest):.2f}°",
            hint="reduce the maximum distance of pairs, or use a format with wider numbers",
        )


def check_content(icrs: NDArray[np.floating], distances: DistanceTable, stars: int) -> None:
    """Raise CorruptData if decoded directions or pairs are not valid; a correct CRC does not guarantee valid
    content."""
    norm = np.linalg.norm(icrs.astype(float), axis=1)
    if not np.all(np.abs(norm - 1) < NORM_TOLERANCE):
        raise CorruptData("a star's direction is not a unit vector", expected="length 1", got=f"row {_worst(icrs)}")
    ends = np.stack([distances.first, distances.second])
    if ends.size and (ends.min() < 0 or ends.max() >= stars or np.any(ends[0] == ends[1])):
        raise CorruptData(
            "a pair refers to a star that is not in the list", expected=f"two different rows from 0 to {stars - 1}"
        )
    step = np.diff(distances.distance_rad)
    if not (np.all(np.isfinite(distances.distance_rad)) and np.all(step >= 0)):
        raise CorruptData("the distance table is not sorted", expected="ascending, finite distances")


def _worst(icrs: NDArray[np.floating]) -> int:
    off = np.abs(np.linalg.norm(icrs.astype(float), axis=1) - 1)
    return int(np.argmax(np.nan_to_num(off, nan=np.inf)))
