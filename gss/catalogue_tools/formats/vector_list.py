"""The star list of far-mst and oersted, whose documents give no bytes (chosen): unit vectors and magnitudes, 14 bytes a star.

Single precision errs by less than 0.02″; magnitudes are whole thousandths, −32 768 where there is none.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gss.catalogue_tools.formats.blocks import Columns, Field, Rows
from gss.catalogue_tools.formats.layout import from_millimag, to_millimag
from gss.domain.stars import StarTable

STARS = Rows(
    "stars",
    (
        Field("x", "<f4", "", "ICRS unit vector"),
        Field("y", "<f4", "", "ICRS unit vector"),
        Field("z", "<f4", "", "ICRS unit vector"),
        Field("v_mmag", "<i2", "0.001 mag", "magnitude V, −32 768 where unknown"),
    ),
)


def star_columns(stars: StarTable) -> Columns:
    """Columns of the star list."""
    x, y, z = stars.icrs.T
    return {"x": x, "y": y, "z": z, "v_mmag": to_millimag(stars.v_mag)}


def directions(stars: Columns) -> NDArray[np.float32]:
    """(n, 3) unit vectors at the device's width."""
    return np.column_stack([stars["x"], stars["y"], stars["z"]]).astype(np.float32)


def magnitudes(stars: Columns) -> NDArray[np.float32]:
    """(n,) magnitudes V."""
    return from_millimag(stars["v_mmag"])
