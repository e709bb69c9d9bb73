"""Create the package's table of Hipparcos stars that are not in the main table: all stars of hip2 fainter than V 8.

Usage: ``python -m tools.make_faint_star_table``, after make_star_table. hip2 does not contain V, which is calculated from
Hp and V−I, with an error of 0.02 mag for non-variable stars. Provenance: docs/star-table.md.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from gss.domain.angles import Array
from tools.make_star_table import B_V, DEC, HIP, HP, PLX, PM_DEC, PM_RA, RA, TARGET, V_I, flags_of, read_hip2

FAINT_TARGET = TARGET.with_name("stars_faint.npz")
HP_MINUS_V_OF_V_I = (-0.00868878, 0.06427474, -0.14456331, -0.00350839, 0.25028408, -0.00038726)
"""Coefficients of g(V−I), highest power first: robust fit to the stars of the main table (rms 0.013 mag)."""


def v_from_hp(hp_mag: Array, v_i: Array) -> Array:
    """Return V = Hp − g(V−I) of (n,) stars, for V−I from −0.5 to 4."""
    return np.asarray(hp_mag - np.polyval(HP_MINUS_V_OF_V_I, v_i))


def faint_table() -> dict[str, NDArray[Any]]:
    """Return the columns of the stars that are not in the main table, in order of V, then of HIP."""
    hip2 = read_hip2()
    with np.load(TARGET) as main_table:
        h = hip2[~np.isin(hip2[:, HIP], main_table["hip"])]
    # The fit of V is valid only up to V−I 4. Redder stars that are not in the table to V 8 are known to be fainter than
    # V 8, so this limit is used for them.
    v_mag = np.maximum(v_from_hp(h[:, HP], np.clip(h[:, V_I], -0.5, 4.0)), 8.01)
    order = np.lexsort((h[:, HIP], np.round(v_mag * 100)))
    h, v_mag = h[order], v_mag[order]
    return {
        "hip": h[:, HIP].astype(np.int32),
        "ra_rad": h[:, RA],
        "dec_rad": h[:, DEC],
        "pm_ra_cos_dec_mas_yr": h[:, PM_RA].astype(np.float32),
        "pm_dec_mas_yr": h[:, PM_DEC].astype(np.float32),
        "parallax_mas": h[:, PLX].astype(np.float32),
        "v_mag": np.round(v_mag * 100).astype(np.int16),
        "b_v": np.round(h[:, B_V] * 1000).astype(np.int16),
        "flags": flags_of(h, np.ones(len(h), bool)),
        "epoch_jyear": np.array(1991.25),
    }


def main() -> None:
    """Write the table."""
    columns = faint_table()
    np.savez_compressed(FAINT_TARGET, allow_pickle=False, **columns)
    v_mag = columns["v_mag"] / 100
    print(f"{len(v_mag)} stars, V {v_mag.min():.2f} to {v_mag.max():.2f}, {FAINT_TARGET.stat().st_size} bytes")


if __name__ == "__main__":
    main()
