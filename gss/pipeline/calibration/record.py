"""Calibrations as plain values and back: what a version in the store, a JSON file and a table of stars hold."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np

from gss.domain.camera import Brown, BrownUndistort, Camera, Distortion, Pinhole, RadialTilt
from gss.domain.errors import BadInput

LENSES: dict[str, type[Any]] = {
    "pinhole": Pinhole,
    "brown": Brown,
    "brown_undistort": BrownUndistort,
    "radial_tilt": RadialTilt,
}
GEOMETRY = ("columns", "rows", "focal_col_px", "focal_row_px", "centre_col_px", "centre_row_px")
MOST_VALUES = 20_000  # larger arrays are images: they have files of their own


def camera_record(camera: Camera) -> dict[str, Any]:
    """{"columns": …, "distortion": {"model": "brown", "k1": …}}."""
    name = next(n for n, kind in LENSES.items() if type(camera.distortion) is kind)
    lens = {"model": name} | {f.name: as_record(getattr(camera.distortion, f.name)) for f in _fields(camera.distortion)}
    return {n: getattr(camera, n) for n in GEOMETRY} | {"distortion": lens}


def camera_from_record(record: Mapping[str, Any]) -> Camera:
    """The inverse of :func:`camera_record`; BadInput where it is not one."""
    try:
        lens = dict(record["distortion"])
        model = lens.pop("model")
        if "radial" in lens:
            lens["radial"] = tuple(float(k) for k in lens["radial"])
        distortion: Distortion = LENSES[model](**lens)
        geometry = {n: record[n] for n in GEOMETRY}
        numbers = {n: int(v) if n in ("columns", "rows") else float(v) for n, v in geometry.items()}
        return Camera(**numbers, distortion=distortion)  # type: ignore[arg-type]
    except (KeyError, TypeError, ValueError) as error:
        raise BadInput(
            "this is not the record of a camera",
            expected=", ".join((*GEOMETRY, "distortion")),
            got=f"{type(error).__name__}: {error}",
        ) from None


def as_record(value: Any) -> Any:
    """Any result of a calibration or an analysis as plain values: dataclasses as dictionaries, arrays as lists, NaN and infinity
    as None, cameras by :func:`camera_record`. Arrays of more than 20 000 values (images) only say their shape."""
    if isinstance(value, Camera):
        return camera_record(value)
    if is_dataclass(value) and not isinstance(value, type):
        return {f.name: as_record(getattr(value, f.name)) for f in _fields(value)}
    if isinstance(value, np.ndarray):
        return {"shape": list(value.shape)} if value.size > MOST_VALUES else as_record(value.tolist())
    if isinstance(value, Mapping):
        return {str(k): as_record(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [as_record(v) for v in value]
    if isinstance(value, np.generic):
        return as_record(value.item())
    if isinstance(value, float) and not np.isfinite(value):
        return None
    return value


def _fields(value: Any) -> tuple[Any, ...]:
    return tuple(f for f in fields(value) if not f.name.startswith("_"))
