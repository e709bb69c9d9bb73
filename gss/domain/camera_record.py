"""Convert a camera's geometry to plain values and back, for stored solutions and calibrations."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from gss.domain.camera import Brown, BrownUndistort, Camera, Pinhole, RadialTilt
from gss.domain.errors import CorruptData
from gss.domain.json_object import JsonObject

MODELS = {model.__name__: model for model in (Pinhole, Brown, BrownUndistort, RadialTilt)}


def record_of(camera: Camera) -> JsonObject:
    """Return a camera as plain values."""
    values = asdict(camera)
    values["distortion"] = {"model": type(camera.distortion).__name__, **values["distortion"]}
    return values


def camera_from(record: Mapping[str, Any]) -> Camera:
    """Return the camera of a record. Raises CorruptData if the record is not valid."""
    try:
        lens = dict(record["distortion"])
        model = MODELS[lens.pop("model")]
        values: JsonObject = {name: tuple(v) if isinstance(v, list) else v for name, v in lens.items()}
        return Camera(**{**record, "distortion": model(**values)})
    except (KeyError, TypeError, ValueError) as error:
        got = f"{type(error).__name__}: {error}"
        expected = f"a camera's geometry, distortion {' | '.join(MODELS)}"
        raise CorruptData("the stored camera is not valid", expected=expected, got=got) from None
