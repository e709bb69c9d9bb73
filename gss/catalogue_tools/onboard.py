"""Bank images: the door to the on-board formats (see :mod:`gss.catalogue_tools.formats` and docs/catalogue-formats.md)."""

from __future__ import annotations

from gss.catalogue_tools.formats.c_source import c_source, read_c_source
from gss.catalogue_tools.formats.header import HEADER, HEADER_BYTES, HEADER_VERSION, MAGIC, SECTIONS_VERSION, BankHeader
from gss.catalogue_tools.formats.own_tables import OwnTables, frame_of, reduced_catalogue, tables_for
from gss.catalogue_tools.formats.registry import (
    BY_NAME,
    C_FORMATS,
    FORMATS,
    QuantisationError,
    base_format,
    check_format,
    core_bytes,
    decode,
    encode,
    encoded_again,
    format_of,
    image_bytes,
    image_end,
    own_format,
    part_bytes,
    quantisation_error,
    read_header,
    stars_of,
)

STAR_BYTES = {name: f.stars.row_bytes for name, f in BY_NAME.items()}
PAIR_BYTES = 8
"""Bytes of a pair in the formats that keep distances as real numbers; of any format: ``format_of(name).pair_bytes``."""

__all__ = [
    "C_FORMATS",
    "FORMATS",
    "HEADER",
    "HEADER_BYTES",
    "HEADER_VERSION",
    "MAGIC",
    "PAIR_BYTES",
    "SECTIONS_VERSION",
    "STAR_BYTES",
    "BankHeader",
    "OwnTables",
    "QuantisationError",
    "base_format",
    "c_source",
    "check_format",
    "core_bytes",
    "decode",
    "encode",
    "encoded_again",
    "format_of",
    "frame_of",
    "image_bytes",
    "image_end",
    "own_format",
    "part_bytes",
    "quantisation_error",
    "read_c_source",
    "read_header",
    "reduced_catalogue",
    "stars_of",
    "tables_for",
]
