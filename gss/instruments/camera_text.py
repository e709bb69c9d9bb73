"""Write ``camera.yaml`` and ``instrument.yaml`` as text for human readers, with one line per number."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any

import yaml

from gss.instruments.camera_file import CameraFile
from gss.instruments.package_files import InstrumentFile
from gss.instruments.quantities import Coefficients, Quantity, Strict

WIDEST = 110


def camera_text(camera: CameraFile, comment: Sequence[str] = ()) -> bytes:
    """Return the file with ``comment`` at its start. Reading the file gives an equal camera."""
    lines = [f"# {line}".rstrip() for line in comment]
    for part_name, part in camera:
        lines += ["", f"{part_name}:"] if lines else [f"{part_name}:"]
        for name, value in part:
            if value is not None:
                lines.append(f"  {name}: {_value(value)}")
    return ("\n".join(lines) + "\n").encode()


def instrument_text(about: InstrumentFile) -> bytes:
    """Return the file. Reading the file gives an equal model."""
    content = about.model_dump(mode="json", exclude_none=True)
    return yaml.safe_dump(content, allow_unicode=True, sort_keys=False, width=WIDEST, default_flow_style=None).encode()


def _value(value: Any) -> str:
    if isinstance(value, Quantity | Coefficients):
        return "{" + ", ".join(f"{name}: {_plain(v)}" for name, v in _ordered(value)) + "}"
    return _plain(value)


def _ordered(number: Strict) -> list[tuple[str, Any]]:
    """Return the fields of a number in the order value, unit, sigma, origin."""
    values = number.model_dump(exclude_none=True)
    order = ("value", "values", "unit", "sigma", "source", "chosen")
    return [(name, values[name]) for name in order if name in values]


def _plain(value: Any) -> str:
    if isinstance(value, float):
        return str(int(value)) if value == int(value) and abs(value) < 1e15 else repr(value)
    return json.dumps(value, ensure_ascii=False)
