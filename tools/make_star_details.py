"""Create the package's table of further hip2 columns of each star: errors, photometry, components, kind of solution.

Usage: ``python -m tools.make_star_details``. Read by gss/catalogue_tools/sources/star_details.py. Provenance:
docs/star-table.md.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tools.make_star_table import ANNEX, COMPONENTS, HIP, HP, HP_SCATTER, SOLUTION, TARGET, V_I, read_hip2

DETAILS_TARGET = TARGET.with_name("star_details.npz")
# Columns of hip2.dat with the standard errors, in table order: RA·cos Dec, Dec, parallax, their motions; mas and
# mas/yr.
ERRORS = (9, 10, 11, 12, 13)
HP_ERROR = 20


def _small(values: NDArray[np.float64], step: float) -> NDArray[np.uint16]:
    return np.clip(np.round(values / step), 0, 65_535).astype(np.uint16)


def main() -> None:
    """Write all rows by Hipparcos number, quantized without relevant loss."""
    h = read_hip2()
    h = h[np.argsort(h[:, HIP])]
    columns = {
        "hip": h[:, HIP].astype(np.int32),
        "errors_centimas": _small(h[:, ERRORS], 0.01),
        "hp_millimag": np.round(h[:, HP] * 1000).astype(np.int16),
        "hp_error_tenthmillimag": _small(h[:, HP_ERROR], 1e-4),
        "hp_scatter_millimag": _small(h[:, HP_SCATTER], 1e-3),
        "v_i_millimag": np.round(h[:, V_I] * 1000).astype(np.int16),
        "components": h[:, COMPONENTS].astype(np.uint8),
        "solution": h[:, SOLUTION].astype(np.uint16),
        "annex": h[:, ANNEX].astype(np.uint8),
    }
    np.savez_compressed(DETAILS_TARGET, **columns)
    print(f"{len(h)} stars, {DETAILS_TARGET.stat().st_size} bytes")


if __name__ == "__main__":
    main()
