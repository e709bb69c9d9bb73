"""Export of a catalogue to files: bank image, manifest, C source, readable tables, and exact tables from which the image can be
restored."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from gss.catalogue_tools.exports import export, export_table, import_table
from gss.catalogue_tools.manifest import manifest_of
from gss.catalogue_tools.onboard import c_source, decode
from gss.domain.errors import BadInput

TYPES = {
    "image": ("bin", "application/octet-stream"),
    "manifest": ("json", "application/json"),
    "c": ("h", "text/x-c"),
    "csv": ("csv", "text/csv"),
    "ecsv": ("ecsv", "text/plain"),
    "fits": ("fits", "application/fits"),
    "parquet": ("parquet", "application/vnd.apache.parquet"),
    "tables-fits": ("tables.fits", "application/fits"),
    "tables-csv": ("tables.csv.zip", "application/zip"),
    "tables-ecsv": ("tables.ecsv.zip", "application/zip"),
    "tables-parquet": ("tables.parquet.zip", "application/zip"),
}


@dataclass(frozen=True)
class ExportFile:
    """Name, media type and content of an exported file."""

    name: str
    media_type: str
    content: bytes


def export_file(image: bytes, manifest: Mapping[str, Any], kind: str, name: str) -> ExportFile:
    """Return a catalogue as a file. ``kind``: image; manifest; c (arrays for firmware source); csv, ecsv, fits or parquet
    (readable star list); tables-* (all tables without loss, from which ``import_file`` restores the image). Raises BadInput for
    an unknown kind."""
    if kind not in TYPES:
        raise BadInput("unknown kind of export", expected=" | ".join(TYPES), got=kind)
    suffix, media_type = TYPES[kind]
    safe = "".join(c if c.isascii() and (c.isalnum() or c in "-_.") else "-" for c in name) or "catalogue"
    return ExportFile(f"{safe}.{suffix}", media_type, _content(image, manifest, kind))


def _content(image: bytes, manifest: Mapping[str, Any], kind: str) -> bytes:
    if kind == "image":
        return image
    if kind == "manifest":
        return json.dumps(manifest, indent=1, sort_keys=True, ensure_ascii=False).encode()
    if kind == "c":
        return c_source(image).encode()
    if kind.startswith("tables-"):
        return export_table(image, kind.removeprefix("tables-"))
    catalogue = decode(image, np.array(manifest["hip"], np.int32))
    return export(catalogue, manifest_of(manifest), kind)


def import_file(data: bytes, filename: str) -> bytes:
    """Return the bank image from a file that was exported with ``tables-*``. Checksums are verified. Raises BadInput."""
    lower = filename.lower()
    kind = next(
        (k.removeprefix("tables-") for k in TYPES if k.startswith("tables-") and lower.endswith(TYPES[k][0])), ""
    )
    if not kind:
        kind = next((k for k in ("fits", "csv", "ecsv", "parquet") if f".{k}" in lower), "")
    if not kind:
        raise BadInput(
            "unknown kind of table file",
            expected=" | ".join(TYPES[k][0] for k in TYPES if k.startswith("tables-")),
            got=filename,
        )
    return import_table(data, kind)
