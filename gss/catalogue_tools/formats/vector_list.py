"""Star list of far-mst and oersted: unit vectors and magnitudes, 14 bytes per star. The layout is chosen, because the
documents do not specify the bytes.

The error of single precision is less than 0.02″; magnitudes are in thousandths, −32 768 if unknown.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gss.catalogue_tools.formats.blocks import BlockField, Columns, Rows
from gss.catalogue_tools.formats.layout import from_millimag, to_millimag
from gss.domain.stars import StarTable

STARS = Rows(
    "stars",
    (
        BlockField("x", "<f4", "", "ICRS unit vector"),
        BlockField("y", "<f4", "", "ICRS unit vector"),
        BlockField("z", "<f4", "", "ICRS unit vector"),
        BlockField("v_mmag", "<i2", "0.001 mag", "magnitude V, −32 768 if unknown"),
    ),
)


def star_columns(stars: StarTable) -> Columns:
    """Return the columns of the star list."""
    x, y, z = stars.icrs.T
    return {"x": x, "y": y, "z": z, "v_mmag": to_millimag(stars.v_mag)}


def directions(stars: Columns) -> NDArray[np.float32]:
    """Return (n, 3) unit vectors at the precision stored on the device."""
    return np.column_stack([stars["x"], stars["y"], stars["z"]]).astype(np.float32)


def magnitudes(stars: Columns) -> NDArray[np.float32]:
    """Return the (n,) magnitudes V."""
    return from_millimag(stars["v_mmag"])
