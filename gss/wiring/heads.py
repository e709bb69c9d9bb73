"""Services of spacecraft with several heads."""

from __future__ import annotations

from dataclasses import dataclass

from gss.operations.heads.head_watch import HeadWatch
from gss.operations.heads.history import HeadHistory
from gss.operations.heads.spacecraft_book import SpacecraftBook
from gss.wiring.base import BaseServices
from gss.wiring.telemetry import TelemetryServices


@dataclass(frozen=True)
class Heads:
    """Services of spacecraft with several heads: the stored spacecraft, their monitor, and the stored history. Only a server with
    several units starts the monitor."""

    book: SpacecraftBook
    watch: HeadWatch
    history: HeadHistory


def open_heads(base: BaseServices, telemetry: TelemetryServices) -> Heads:
    """Create the services of spacecraft with several heads."""
    database, now = base.database, base.clock.now
    book = SpacecraftBook(database, base.bus, now)
    return Heads(book, HeadWatch(book, database, telemetry.alarms, now), HeadHistory(database, now))
