"""Temperatures of a unit from a CSV file, for frames that are files."""

from __future__ import annotations

import argparse
import csv
import io
from datetime import UTC, datetime
from typing import TYPE_CHECKING

from gss.cli.input_files import TEXT_BYTES, read_file
from gss.domain.errors import BadInput

if TYPE_CHECKING:
    from gss.domain.angles import Array


def add_temperatures(parser: argparse.ArgumentParser) -> None:
    """Add the option ``--temperatures``."""
    parser.add_argument(
        "--temperatures", metavar="FILE", help="CSV: time in ISO 8601 (UTC), temperature of the unit in °C"
    )


def read_temperatures(name: str | None) -> tuple[Array, Array] | None:
    """Return Unix seconds and °C of a file, sorted by time; None without a file. Raises BadInput."""
    import numpy as np

    if name is None:
        return None

    text = read_file(name, "temperatures", TEXT_BYTES).decode("utf-8", "replace")
    rows = []
    for number, cells in enumerate(csv.reader(io.StringIO(text)), start=1):
        if not cells or (number == 1 and not cells[0][:1].isdigit()):
            continue
        try:
            time, celsius = datetime.fromisoformat(cells[0].strip()), float(cells[1])
        except (ValueError, IndexError):
            raise BadInput(
                "temperatures cannot be read",
                expected="time,°C in each line",
                got=f"line {number}: {','.join(cells)[:40]}",
            ) from None
        rows.append((time.replace(tzinfo=time.tzinfo or UTC).timestamp(), celsius))
    table = np.array(sorted(rows), float).reshape(-1, 2)
    return table[:, 0], table[:, 1]
