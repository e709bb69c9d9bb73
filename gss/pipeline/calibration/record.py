"""Calibrations as plain values: what a version in the store, a JSON file and a table of stars hold."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np

from gss.domain.camera import Camera
from gss.domain.camera_record import record_of

MOST_VALUES = 20_000  # larger arrays are images: they have files of their own


def as_record(value: Any) -> Any:
    """Any result of a calibration or an analysis as plain values: dataclasses as dictionaries, arrays as lists, NaN and infinity
    as None, cameras by ``record_of``. Arrays of more than 20 000 values (images) only say their shape."""
    if isinstance(value, Camera):
        return as_record(record_of(value))
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
