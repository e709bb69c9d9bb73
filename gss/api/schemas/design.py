"""Documented cameras for a design. The request and the values of a design are in gss.operations.catalogues."""

from __future__ import annotations

from gss.api.schemas.base import Out
from gss.operations.catalogues.design_values import FieldLimit, TradeValues


class DesignCameraOut(Out):
    """Documented camera as a starting point of a design. The field names state the units."""

    name: str
    title: str
    values: dict[str, float]
    sources: dict[str, str]


class DesignCamerasOut(Out):
    """Cameras as starting points, and the allowed ranges of the editable fields. ``unit``: camera of the configured
    instrument."""

    unit: str
    cameras: list[DesignCameraOut]
    rows: list[TradeValues]
    limits: dict[str, FieldLimit]
