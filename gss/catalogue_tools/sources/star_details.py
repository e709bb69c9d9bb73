"""Further Hipparcos data of a star: standard errors, photometry, components.

Kept apart from the star table, which every process loads; used for error budgets and for details of a single star.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from importlib.resources import files

import numpy as np
from numpy.typing import NDArray

from gss.catalogue_tools.sources.hipparcos import MAS_RAD, TABLE_EPOCH_JYEAR
from gss.domain.angles import Array
from gss.domain.stars import StarTable

# Largest error that the file can represent; the few rows with it mean "or more".
LARGEST_ERROR_RAD = 655.35 * MAS_RAD


@dataclass(frozen=True)
class Details:
    """Details of the requested rows; NaN (0 for counts) if Hipparcos has no such star.

    ``position_error_rad`` and ``motion_error_rad_yr``: (n, 2) standard errors east and north, at J1991.25.
    ``hp_scatter_mag``: of the single transits. ``components``: number in the solution. ``solution``: hip2's code; 5 is
    a plain single star.
    """

    position_error_rad: Array
    motion_error_rad_yr: Array
    parallax_error_rad: Array
    hp_mag: Array
    hp_error_mag: Array
    hp_scatter_mag: Array
    v_i: Array
    components: NDArray[np.int64]
    solution: NDArray[np.int64]

    def error_at_rad(self, epoch_jyear: float) -> Array:
        """(n,) standard error of the position at an epoch, larger axis; errors of position and motion are taken as
        independent."""
        years = epoch_jyear - TABLE_EPOCH_JYEAR
        axes = np.hypot(self.position_error_rad, self.motion_error_rad_yr * years)
        return np.asarray(axes.max(axis=1))


def details_of(stars: StarTable) -> Details:
    """Return the details of the rows of a table, by their Hipparcos numbers."""
    c = _columns()
    row = np.searchsorted(c["hip"], stars.hip)
    row = np.minimum(row, len(c["hip"]) - 1)
    same_hip = c["hip"][row] == stars.hip

    def pick(name: str, step: float) -> Array:
        values = c[name][row].astype(float) * step
        return np.where(same_hip if values.ndim == 1 else same_hip[:, None], values, np.nan)

    errors = pick("errors_centimas", 0.01 * MAS_RAD)
    return Details(
        errors[:, :2],
        errors[:, 3:],
        errors[:, 2],
        pick("hp_millimag", 1e-3),
        pick("hp_error_tenthmillimag", 1e-4),
        pick("hp_scatter_millimag", 1e-3),
        pick("v_i_millimag", 1e-3),
        np.where(same_hip, c["components"][row].astype(np.int64), 0),
        np.where(same_hip, c["solution"][row].astype(np.int64), 0),
    )


@lru_cache(maxsize=1)
def _columns() -> dict[str, NDArray[np.integer]]:
    with (files(__package__) / "data" / "star_details.npz").open("rb") as file, np.load(file) as archive:
        return {name: archive[name] for name in archive.files}
