"""Exports a calibration as JSON with all data, as ECSV with the parameters and their uncertainties, or as a report."""

from __future__ import annotations

import json

from gss.operations.report.html import as_html
from gss.operations.report.pdf import as_pdf
from gss.operations.studies.calibration_sheet import calibration_sheet
from gss.store.models import Calibration

KINDS = {
    "json": "application/json",
    "ecsv": "text/plain; charset=utf-8",
    "html": "text/html; charset=utf-8",
    "pdf": "application/pdf",
}


def export_calibration(row: Calibration, kind: str) -> bytes:
    """Return a calibration as a file. ``kind``: one of KINDS."""
    if kind == "html":
        return as_html(calibration_sheet(row)).encode()
    if kind == "pdf":
        return as_pdf(calibration_sheet(row), row.created)
    return _json(row) if kind == "json" else _ecsv(row)


def _head(row: Calibration) -> dict[str, object]:
    names = ["id", "profile", "kind", "name", "author", "tool", "note"]
    return {name: getattr(row, name) for name in names} | {"created": row.created.isoformat()}


def _json(row: Calibration) -> bytes:
    content = _head(row) | {"request": row.request, "values": row.values, "result": row.result}
    return json.dumps(content, indent=1, ensure_ascii=False, allow_nan=False).encode()


def _ecsv(row: Calibration) -> bytes:
    """Return Enhanced CSV 1.0 (astropy APE 6). It has one row per parameter of the geometry, or, if the calibration has
    no geometry, one row per value."""
    parameters = row.result.get("geometry", {}).get("parameters") or [
        {"name": name, "value": value, "sigma": None, "unit": ""}
        for name, value in row.values.items()
        if isinstance(value, int | float)
    ]
    meta = json.dumps(_head(row), ensure_ascii=False)
    lines = [
        "# %ECSV 1.0",
        "# ---",
        "# datatype:",
        "# - {name: name, datatype: string}",
        "# - {name: value, datatype: float64}",
        "# - {name: sigma, datatype: float64}",
        "# - {name: unit, datatype: string}",
        f"# meta: {meta}",
        "# schema: astropy-2.0",
        "name value sigma unit",
    ]
    for parameter in parameters:
        sigma = "nan" if parameter["sigma"] is None else repr(parameter["sigma"])
        lines.append(f"{parameter['name']} {parameter['value']!r} {sigma} {parameter['unit'] or chr(34) * 2}")
    return ("\n".join(lines) + "\n").encode()
