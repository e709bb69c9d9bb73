"""Built catalogues."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from gss.api.schemas.catalogues import CatalogueDetailOut, CatalogueOut
from gss.operations.banks import BankView
from gss.store.models import Catalogue


def catalogue(row: Catalogue, banks: Sequence[BankView]) -> CatalogueOut:
    """A built catalogue."""
    return CatalogueOut(**_catalogue_values(row, banks))


def _catalogue_values(row: Catalogue, banks: Sequence[BankView]) -> dict[str, Any]:
    names = "id name profile format created author stars pairs sha256 valid_from valid_to"
    values = {name: getattr(row, name) for name in names.split()}
    return values | {"bytes": row.size, "banks": [b.bank for b in banks if b.sha256 == row.sha256]}


def catalogue_detail(row: Catalogue, banks: Sequence[BankView]) -> CatalogueDetailOut:
    """A built catalogue with map and quality; one that was read back has neither."""
    return CatalogueDetailOut(
        **_catalogue_values(row, banks),
        request=row.request,
        manifest=row.manifest,
        funnel=row.report.get("funnel", []),
        sky=row.report.get("sky", []),
        envelope=row.report.get("envelope"),
        quality=row.report.get("quality"),
    )
