"""Rows of transfers: published on each change, and complete enough to restart a transfer after a crash."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from gss.device.session import Compatibility, HeldPart, HostSession, Part
from gss.device.session_events import Direction, TransferUpdate
from gss.domain.errors import BadInput
from gss.operations.clock import Now
from gss.operations.events import EventBus
from gss.store import transfers as store
from gss.store.blobs import BlobStore
from gss.store.engine import Database
from gss.store.models import Transfer

LOG_LINES = 40


@dataclass(frozen=True)
class TransferView:
    """A transfer's row with its current progress; None if it is not in progress."""

    row: Transfer
    live: TransferUpdate | None


class TransferRows:
    """Changes rows and publishes them."""

    def __init__(self, database: Database, bus: EventBus, now: Now) -> None:
        self._database, self._bus, self._now = database, bus, now

    def note(self, row_id: int, words: str = "", live: TransferUpdate | None = None, **values: Any) -> Transfer:
        """Change the row, append a line to its log, and publish it."""
        if not words and "state" in values and live is None:
            words = f"{values['state']}: {values['reason']}" if values.get("reason") else str(values["state"])
        with self._database.unit_of_work() as session:
            row = store.get(session, row_id)
            for name, value in values.items():
                setattr(row, name, value)
            if words:
                row.log = [*row.log[-LOG_LINES:], f"{self._now():%H:%M:%SZ} {words}"]
        self._bus.publish("transfer", TransferView(row, live))
        return row


Start = Callable[[HostSession, float], int]
"""Starts a transfer in a session at ``now_s`` and returns its number there; needs neither store nor files."""


def prepare(row: Transfer, blobs: BlobStore, held: HeldPart | None = None, paused: str | None = None) -> Start:
    """Read what a session needs to start the transfer described by ``row``. ``held``, ``paused``: see ``HostSession``.
    Raises BadInput."""
    options = row.options
    if "slot" not in options:
        raise BadInput("it was begun by an older version", hint="start it anew")
    slot, reason = int(options["slot"]), paused or ""
    if row.direction == Direction.DOWN:
        part = Part(**options["part"]) if options.get("part") else None
        return lambda session, now_s: session.start_download(row.kind, slot, now_s, held=held, part=part, paused=reason)
    facts = options["compatibility"]
    compatibility = Compatibility(**(facts | {"dictionary_hash": bytes.fromhex(facts["dictionary_hash"])}))
    data = blobs.get(options["content"])
    return lambda session, now_s: session.start_upload(row.kind, slot, data, compatibility, now_s, paused=reason)


def words_of(update: TransferUpdate) -> str:
    """Return a log line: state, whether it was resumed, and reason or progress."""
    state = str(update.state).replace("_", " ")
    resumed = " (resumed)" if update.resumed else ""
    return (
        f"{state}{resumed}: {update.reason}" if update.reason else f"{state}{resumed}, {update.stored_bytes} B stored"
    )
