"""Conversion of calibrations to plain values for the store, JSON files and star tables."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np

from gss.domain.camera import Camera
from gss.domain.camera_record import record_of

MAX_VALUES = 20_000  # larger arrays are images, which are stored as separate files


def as_record(value: Any) -> Any:
    """Convert any result of a calibration or an analysis to plain values: dataclasses to dictionaries, arrays to lists, NaN and
    infinity to None, cameras by ``record_of``. Arrays of more than 20 000 values (images) are replaced by their shape."""
    if isinstance(value, Camera):
        return as_record(record_of(value))
    if is_dataclass(value) and not isinstance(value, type):
        return {f.name: as_record(getattr(value, f.name)) for f in _fields(value)}
    if isinstance(value, np.ndarray):
        return {"shape": list(value.shape)} if value.size > MAX_VALUES else as_record(value.tolist())
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
