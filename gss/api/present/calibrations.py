"""Calibrations as responses."""

from __future__ import annotations

from collections.abc import Sequence

from gss.api.schemas.calibrations import CalibrationDetailOut, CalibrationDiffOut, CalibrationOut, ChangeOut
from gss.domain.angles import ARCSEC_RAD
from gss.operations.studies.calibration_sheet import calibration_sheet
from gss.operations.studies.calibrations import NO_BAD_PIXEL_TABLE, Comparison
from gss.operations.transfers.device_tables import TableReport
from gss.store.models import Calibration

NAMES = "id profile kind name created author tool note table_id"


def calibration(row: Calibration, in_use: bool, reports: Sequence[TableReport]) -> CalibrationOut:
    """Return a calibration as a list entry."""
    geometry = row.result.get("geometry", {})
    return CalibrationOut(
        **{name: getattr(row, name) for name in NAMES.split()},
        frames=len(row.request.get("frame_ids") or row.request.get("dark_ids") or []),
        in_use=in_use,
        sendable=bool(row.values),
        places=_places(row.table_id, reports),
        warnings=len(row.result.get("warnings", [])),
        model=geometry.get("model"),
        rms_px=geometry.get("residuals", {}).get("rms_px"),
        rms_before_px=geometry.get("before", {}).get("rms_px"),
        focal_px=row.values.get("focal_col_px") or geometry.get("camera", {}).get("focal_col_px"),
    )


def _places(table_id: int | None, reports: Sequence[TableReport]) -> list[str]:
    on_board = [r for r in reports if table_id is not None and r.table_id == table_id]
    return [f"{r.bank}, {'active' if r.active else r.state}" for r in on_board]


def detail(
    row: Calibration, in_use: bool, reports: Sequence[TableReport], takes_bad_pixels: bool
) -> CalibrationDetailOut:
    """Return a calibration with its results and its report. ``takes_bad_pixels``: the sensor has a bad-pixel table."""
    dark = row.result.get("dark_frame")
    return CalibrationDetailOut(
        **dict(calibration(row, in_use, reports)),
        bad_pixels=int(dark["bad"]) if isinstance(dark, dict) else 0,
        bad_pixel_table_id=row.bad_pixel_table_id,
        bad_pixel_places=_places(row.bad_pixel_table_id, reports),
        no_bad_pixel_table="" if takes_bad_pixels else NO_BAD_PIXEL_TABLE,
        request=row.request,
        values=row.values,
        result=row.result,
        report=calibration_sheet(row),
    )


def difference(comparison: Comparison) -> CalibrationDiffOut:
    """Return the comparison of two calibrations."""
    return CalibrationDiffOut(
        older=comparison.older.id,
        newer=comparison.newer.id,
        rms_px=float(comparison.geometry.rms_px),
        max_px=float(comparison.geometry.max_px),
        rotation_arcsec=[float(a) / ARCSEC_RAD for a in comparison.geometry.rotation_rad],
        changed=[ChangeOut(name=n, older=pair[0], newer=pair[1]) for n, pair in comparison.changed.items()],
    )
