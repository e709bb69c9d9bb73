"""Create the package's table of Hipparcos stars that are not in the main table: all stars of hip2 fainter than V 8.

Usage: ``python -m tools.make_faint_star_table``, after make_star_table. hip2 does not contain V. V is Hp − g(V−I) as in
gss/catalogue_tools/sources/hipparcos.py, accurate to 0.02 mag for non-variable stars. Provenance: docs/star-table.md.
"""

from __future__ import annotations

import numpy as np

from gss.catalogue_tools.sources.hipparcos import v_from_hp
from tools.make_star_table import B_V, DEC, HIP, HP, PLX, PM_DEC, PM_RA, RA, TARGET, V_I, flags_of, read_hip2

FAINT_TARGET = TARGET.with_name("stars_faint.npz")


def main() -> None:
    """Select the stars that are not in the main table, sort them by V, then HIP, and write the table."""
    hip2 = read_hip2()
    with np.load(TARGET) as main_table:
        h = hip2[~np.isin(hip2[:, HIP], main_table["hip"])]
    # The fit of V is valid only up to V−I 4. Redder stars that are not in the table to V 8 are known to be fainter than
    # V 8, so this limit is used for them.
    v_mag = np.maximum(v_from_hp(h[:, HP], np.clip(h[:, V_I], -0.5, 4.0)), 8.01)
    order = np.lexsort((h[:, HIP], np.round(v_mag * 100)))
    h, v_mag = h[order], v_mag[order]
    columns = {
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
    np.savez_compressed(FAINT_TARGET, **columns)
    print(f"{len(h)} stars, V {v_mag.min():.2f} to {v_mag.max():.2f}, {FAINT_TARGET.stat().st_size} bytes")


if __name__ == "__main__":
    main()
