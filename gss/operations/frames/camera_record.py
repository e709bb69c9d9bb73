"""A camera's geometry as plain values and back, so that a stored solution keeps what it was measured with."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from gss.domain.camera import Brown, BrownUndistort, Camera, Pinhole, RadialTilt
from gss.domain.errors import CorruptData

MODELS = {model.__name__: model for model in (Pinhole, Brown, BrownUndistort, RadialTilt)}


def record_of(camera: Camera) -> dict[str, Any]:
    """Plain values of a camera."""
    values = asdict(camera)
    values["distortion"] = {"model": type(camera.distortion).__name__, **values["distortion"]}
    return values


def camera_from(record: Mapping[str, Any]) -> Camera:
    """The camera of a record."""
    distortion = dict(record["distortion"])
    model = MODELS.get(distortion.pop("model", ""))
    if model is None:
        raise CorruptData("unknown distortion model in a stored camera", expected=" | ".join(MODELS))
    values: dict[str, Any] = {
        name: tuple(value) if isinstance(value, list) else value for name, value in distortion.items()
    }
    return Camera(**{**record, "distortion": model(**values)})
