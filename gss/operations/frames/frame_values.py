"""Columns of a frame's row that describe its pixels. The store contains the complete rows as read out; ``Frame.columns`` is
the number of light-sensitive columns, and ``Frame.parameters`` has the numbers of dark columns, if there are any."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gss.domain.camera_profile import CameraProfile
from gss.domain.dark_columns import DarkColumns
from gss.store.models import Frame

DARK_COLUMNS = "dark_columns"


def frame_values(
    picture: NDArray[np.generic], profile: CameraProfile | None, values: Mapping[str, Any]
) -> dict[str, object]:
    """Return the ``values`` of a row with the columns that describe a (rows, n) picture. ``profile``: documented camera of the
    frame. A picture that is wider than its ``columns`` by the dark columns contains complete rows."""
    rows, columns = picture.shape
    parameters = dict(values.get("parameters", {}))
    if profile is not None:
        dark_columns = profile.sensor.dark_columns
        if dark_columns.split(picture, profile.camera.columns)[1] is not None:
            columns = profile.camera.columns
            parameters[DARK_COLUMNS] = [dark_columns.left, dark_columns.right]
    described = {"columns": columns, "rows": rows, "dtype": picture.dtype.str, "rows_held": [[0, rows - 1]]}
    return described | dict(values) | {"parameters": parameters}


def dark_columns_of(frame: Frame) -> DarkColumns:
    """Return the dark columns in the stored rows of a frame."""
    return DarkColumns(*(frame.parameters or {}).get(DARK_COLUMNS, ()))
