"""Export of solutions of stored frames as a CSV or Parquet table, with one row per solution and units in the column names.
``taken`` is empty if the time of the frame is unknown."""

from __future__ import annotations

import io
import math

import numpy as np
import pyarrow as pa
from pyarrow import csv as pa_csv
from pyarrow import parquet as pa_parquet

from gss.domain.angles import ARCSEC_RAD
from gss.domain.errors import BadInput
from gss.domain.frames import ra_dec_roll_rad
from gss.domain.rotation import matrix_from_quaternion
from gss.store import frames as store
from gss.store.engine import Database
from gss.store.models import Frame, Solution

FORMATS = {"csv": "text/csv; charset=utf-8", "parquet": "application/vnd.apache.parquet"}
ANGLES = ("ra_deg", "dec_deg", "roll_deg")
FLOATS = (
    "exposure_s",
    *ANGLES,
    *(f"quaternion_{axis}" for axis in "xyzw"),
    "sigma_cross_arcsec",
    "sigma_roll_arcsec",
    "rms_px",
    "false_match_probability",
    "error_axis_arcsec",
    "error_roll_arcsec",
    "time_ms",
)
SCHEMA = pa.schema(
    [
        ("solution_id", pa.int64()),
        ("frame_id", pa.int64()),
        ("frame_number", pa.int64()),
        ("contact_id", pa.int64()),
        ("taken", pa.timestamp("us", tz="UTC")),
        ("frame", pa.string()),
        ("profile", pa.string()),
        ("origin", pa.string()),
        ("chain", pa.string()),
        ("version", pa.string()),
        ("created", pa.timestamp("us", tz="UTC")),
        ("outcome", pa.string()),
        ("reason", pa.string()),
        ("found", pa.int64()),
        ("matched", pa.int64()),
        ("verdict", pa.string()),
        ("replay", pa.string()),
        ("camera_name", pa.string()),
        ("operational", pa.bool_()),
        ("options", pa.string()),
        *((name, pa.float64()) for name in FLOATS),
    ]
)


def export_solutions(database: Database, file_format: str, chain: str = "") -> bytes:
    """Return all stored solutions as a table, oldest first. ``chain``: export only solutions of this chain. Raises BadInput for an
    unknown format."""
    if file_format not in FORMATS:
        raise BadInput("unknown format", expected=" | ".join(FORMATS), got=file_format)
    with database.unit_of_work() as session:
        rows = [as_row(frame, solution) for frame, solution in store.results(session, chain)]
    table = pa.Table.from_pylist(rows, schema=SCHEMA)
    sink = io.BytesIO()
    if file_format == "csv":
        pa_csv.write_csv(table, sink)
    else:
        pa_parquet.write_table(table, sink)
    return sink.getvalue()


def as_row(frame: Frame, solution: Solution) -> dict[str, object]:
    """Return the columns of a solution as defined by SCHEMA."""
    values: dict[str, object] = {
        "solution_id": solution.id,
        "frame_id": frame.id,
        "frame_number": frame.number,
        "contact_id": frame.contact_id,
        "taken": frame.taken if frame.time_known else None,
        "frame": frame.name,
        "profile": frame.profile,
        "exposure_s": frame.exposure_s,
        "time_ms": 1e3 * sum(solution.timing_s.values()) if solution.timing_s else None,
    }
    names = "origin chain version created outcome reason found matched verdict replay rms_px false_match_probability"
    names += " camera_name operational options"
    values |= {name: getattr(solution, name) for name in names.split()}
    if solution.quaternion is not None:
        quaternion = np.array(solution.quaternion, float)
        angles = ra_dec_roll_rad(matrix_from_quaternion(quaternion))
        values |= dict(zip(ANGLES, map(math.degrees, angles), strict=True))
        values |= {f"quaternion_{a}": float(q) for a, q in zip("xyzw", quaternion, strict=True)}
    cross_rad, roll_rad = solution.sigma_rad or (None, None)
    return values | {
        "sigma_cross_arcsec": _arcsec(cross_rad),
        "sigma_roll_arcsec": _arcsec(roll_rad),
        "error_axis_arcsec": _arcsec(solution.error_axis_rad),
        "error_roll_arcsec": _arcsec(solution.error_roll_rad),
    }


def _arcsec(value_rad: float | None) -> float | None:
    return None if value_rad is None else value_rad / ARCSEC_RAD
