"""Bank images: public interface of the on-board formats (see :mod:`gss.catalogue_tools.formats` and
docs/catalogue-formats.md)."""

from __future__ import annotations

from gss.catalogue_tools.formats.c_source import c_source, read_c_source
from gss.catalogue_tools.formats.header import HEADER, HEADER_BYTES, HEADER_VERSION, MAGIC, SECTIONS_VERSION, BankHeader
from gss.catalogue_tools.formats.own_tables import OwnTables, frame_of, reduced_catalogue, tables_for
from gss.catalogue_tools.formats.registry import (
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
    part_bytes,
    quantisation_error,
    read_header,
    stars_of,
)

__all__ = [
    "C_FORMATS",
    "FORMATS",
    "HEADER",
    "HEADER_BYTES",
    "HEADER_VERSION",
    "MAGIC",
    "SECTIONS_VERSION",
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
    "part_bytes",
    "quantisation_error",
    "read_c_source",
    "read_header",
    "reduced_catalogue",
    "stars_of",
    "tables_for",
]
