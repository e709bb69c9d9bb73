"""Device tables as responses."""

from __future__ import annotations

from collections.abc import Sequence

from gss.api.schemas.tables import OnBoardTableOut, TableDetailOut, TableOut, TablePlaceOut
from gss.operations.transfers.device_tables import TableReport
from gss.store.models import DeviceTable

NAMES = "id kind name profile format_version size sha256 created author"


def table(row: DeviceTable, reports: Sequence[TableReport]) -> TableOut:
    """Return a table and the banks that contain it."""
    return TableOut(**{name: getattr(row, name) for name in NAMES.split()}, on_board=_banks(row, reports))


def table_detail(row: DeviceTable, reports: Sequence[TableReport]) -> TableDetailOut:
    """Return a table with its values."""
    values = {name: getattr(row, name) for name in NAMES.split()}
    return TableDetailOut(**values, on_board=_banks(row, reports), content=row.content)


def _banks(row: DeviceTable, reports: Sequence[TableReport]) -> list[TablePlaceOut]:
    on_board = [r for r in reports if (r.table, r.sha256) == (row.kind, row.sha256)]
    return [TablePlaceOut.model_validate(r) for r in on_board]


def on_board(reports: Sequence[TableReport]) -> list[OnBoardTableOut]:
    """Return the tables that the device reports."""
    return [OnBoardTableOut.model_validate(r) for r in reports]
