"""Services of catalogues."""

from __future__ import annotations

from dataclasses import dataclass

from gss.operations.catalogues.build_catalogue import CatalogueService
from gss.operations.catalogues.design import DesignService
from gss.operations.catalogues.star_card import StarCards
from gss.operations.catalogues.star_lists import StarListService
from gss.wiring.base import BaseServices
from gss.wiring.line import Line
from gss.wiring.transfers import Transfers


@dataclass(frozen=True)
class Catalogues:
    """Services of catalogues, of the star lists from which they are built, of camera designs, and of single stars."""

    catalogues: CatalogueService
    star_lists: StarListService
    design: DesignService
    stars: StarCards


def open_catalogues(base: BaseServices, line: Line, transfers: Transfers) -> Catalogues:
    """Create the catalogue services."""
    star_lists = StarListService(base.database, base.blobs, base.clock.now, base.parsing, base.instruments)
    catalogues = CatalogueService(
        base.database,
        base.blobs,
        base.jobs,
        transfers.transfers,
        transfers.flash,
        line.link,
        star_lists,
        base.stars,
        base.clock.now,
        base.instruments,
        base.unit.name,
    )
    design = DesignService(base.jobs, base.stars, base.instruments, base.unit.name)
    return Catalogues(catalogues, star_lists, design, StarCards(base.database, base.clock.now))
