"""Items of a pass plan: a procedure, a download or an upload. Each item is started once. A service for the type of item
starts, pauses and stops the item and reports its state."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from typing import Literal

from gss.domain.errors import BadInput, Conflict, GssError, NotFound
from gss.operations.catalogues.build_catalogue import CatalogueService
from gss.operations.procedures.procedures import ProcedureService, hash_of
from gss.operations.procedures.runs import ProcedureRunner
from gss.operations.transfers.downloads import Downloads, permission_of
from gss.operations.transfers.transfers import TransferService

ItemKind = Literal["procedure", "download", "upload"]
ItemState = Literal["waiting", "starting", "running", "done", "failed", "stopped", "unknown"]
MAX_ITEMS = 50
MAX_ITEM_S = 86_400.0
TRANSFER_COMPLETE = ("committed", "active", "done")
TRANSFER_FAILED = ("failed", "aborted")


@dataclass(frozen=True)
class PlanItem:
    """An item of a pass plan. ``content``: kind of a download, with its ``slot`` or ``bank``. ``catalogue_id`` and ``bank``:
    catalogue and destination of an upload. ``reviewed_sha256``: hash of the procedure when the plan was created.
    ``started_id``: id of the run or transfer. ``started``, ``finished``: ISO 8601."""

    kind: ItemKind
    title: str
    estimated_s: float
    procedure_id: int | None = None
    content: str = ""
    slot: int | None = None
    bank: str | None = None
    catalogue_id: int | None = None
    reviewed_sha256: str = ""
    state: ItemState = "waiting"
    started_id: int | None = None
    detail: str = ""
    started: str = ""
    finished: str = ""

    def at(self, state: ItemState, now: datetime, detail: str = "") -> PlanItem:
        """Return the item with another state and the time of its start or end."""
        began = now.isoformat() if state == "starting" else self.started
        ended = now.isoformat() if state in ("done", "failed", "stopped", "unknown") else ""
        return replace(self, state=state, detail=detail, started=began, finished=ended)


class ItemControl:
    """Checks and controls items. ``permits``: raises NotPermitted if a user does not have a permission."""

    def __init__(
        self,
        procedures: ProcedureService,
        procedure_runs: ProcedureRunner,
        downloads: Downloads,
        transfers: TransferService,
        catalogues: CatalogueService,
        permits: Callable[[str, str], None],
    ) -> None:
        self._procedures, self._procedure_runs = procedures, procedure_runs
        self._downloads, self._transfers = downloads, transfers
        self._catalogues, self._permits = catalogues, permits

    def checked(self, item: PlanItem) -> PlanItem:
        """Return the item with its title. Raises BadInput if the item is not valid, NotFound if its procedure or catalogue
        does not exist."""
        if not 0 < item.estimated_s <= MAX_ITEM_S:
            raise BadInput(
                "the estimated duration is out of range",
                expected=f"above 0, to {MAX_ITEM_S:g} s",
                got=f"{item.estimated_s:g}",
            )
        if item.kind == "procedure" and item.procedure_id is not None:
            procedure = self._procedures.get(item.procedure_id)
            self._procedures.valid(procedure)
            return replace(item, title=f"Procedure {procedure.name}", reviewed_sha256=self._hash(item))
        if item.kind == "upload" and item.catalogue_id is not None and item.bank:
            return replace(item, title=f"Upload {self._catalogues.get(item.catalogue_id).name} to bank {item.bank}")
        if item.kind == "download" and item.content and (item.slot is None) != (item.bank is None):
            source = f"slot {item.slot}" if item.bank is None else f"bank {item.bank}"
            return replace(item, title=f"Download {item.content.replace('_', ' ')} of {source}")
        raise BadInput(
            f"an item of kind {item.kind} is not complete",
            expected="procedure_id; or content with slot or bank; or catalogue_id with bank",
            got=item.kind,
        )

    def confirm(self, items: Sequence[PlanItem], *, user: str) -> list[str]:
        """Return the names that the user must type before a plan is armed. Raises NotPermitted if the user does not have the
        permission for an item, NotFound if an item's procedure no longer exists."""
        names: dict[str, None] = {}
        for item in items:
            self.require(item, user)
            if item.procedure_id is not None:
                names |= dict.fromkeys(self._procedure_runs.confirmations(item.procedure_id, user=user))
        return list(names)

    def problem(self, item: PlanItem) -> str:
        """Return the reason why the procedure of an item is not known to be the one of the plan; "" if it is."""
        try:
            if item.reviewed_sha256 == self._hash(item):
                return ""
        except NotFound:
            pass
        if not item.reviewed_sha256:
            return f"{item.title} was added by an earlier version of GSS, which did not store its hash"
        return f"{item.title} was changed or deleted after the plan was created"

    def _hash(self, item: PlanItem) -> str:
        """Return the SHA-256 of the procedure's text. Return "" for a transfer, because the content of a transfer has a
        separate hash."""
        if item.procedure_id is None:
            return ""
        return hash_of(self._procedures.get(item.procedure_id).text)

    def require(self, item: PlanItem, user: str) -> None:
        """Raise NotPermitted if the user does not have the permissions for the item."""
        self._permits(user, "passes")
        if item.procedure_id is not None:
            self._permits(user, "procedures")
            self._procedure_runs.confirmations(item.procedure_id, user=user)
        else:
            self._permits(user, permission_of(item.content) if item.kind == "download" else "catalogues.upload")

    def start(self, item: PlanItem, confirm: Sequence[str], *, user: str, aborts: int) -> int:
        """Start an item and return the id of its run or transfer. ``aborts``: number of ABORTs that the plan has handled; after
        a further ABORT, a procedure sends no command. Raises Conflict if its procedure is not the one of the
        plan, GssError if the item cannot start."""
        self.require(item, user)
        problem = self.problem(item)
        if problem:
            raise Conflict(problem, hint="Review it, then create and arm a new plan.")
        if item.procedure_id is not None:
            return self._procedure_runs.begin(
                item.procedure_id,
                user=user,
                sha256=item.reviewed_sha256,
                automatic=True,
                confirmed=confirm,
                aborts=aborts,
            ).id
        if item.catalogue_id is not None:
            return self._catalogues.upload(item.catalogue_id, item.bank or "").row.id
        return self._downloads.start(item.content, slot=item.slot, bank=item.bank).row.id

    def state(self, item: PlanItem) -> tuple[ItemState, str]:
        """Return the state of a started item, and the reason for its failure or the action that it waits for."""
        if item.started_id is None:
            return "unknown", "its start was not recorded"
        if item.kind == "procedure":
            return self._state_of_procedure(item.started_id)
        row = self._transfers.get(item.started_id).row
        if row.state in TRANSFER_COMPLETE or (row.state == "verified" and row.direction == "down"):
            return "done", ""
        return ("failed", row.reason or row.state) if row.state in TRANSFER_FAILED else ("running", "")

    def _state_of_procedure(self, run_id: int) -> tuple[ItemState, str]:
        row, waiting = self._procedure_runs.state(run_id)
        if row.state == "running":
            return "running", f"step {waiting} waits for an operator on the page Procedures" if waiting else ""
        if row.state == "aborted":
            return "stopped", row.reason
        return ("done", "") if row.state == "completed" else ("failed", row.reason or row.state)

    def pause(self, item: PlanItem) -> None:
        """Pause a started item. An item that has already ended is not changed."""
        if item.started_id is not None:
            with contextlib.suppress(GssError):
                if item.kind == "procedure":
                    self._procedure_runs.hold(item.started_id)
                else:
                    self._transfers.pause(item.started_id)

    def resume(self, item: PlanItem) -> None:
        """Continue a paused item. Raises GssError if it cannot continue."""
        if item.started_id is None or self.state(item)[0] != "running":
            return
        if item.kind == "procedure":
            self._procedure_runs.release(item.started_id)
        elif self._transfers.get(item.started_id).row.state == "paused":
            self._transfers.resume(item.started_id)

    def interrupt(self, item: PlanItem, reason: str) -> str:
        """Mark a procedure run that was in progress when the server restarted as interrupted. An operator can then resume the
        run, and another procedure can start. Return an instruction for the operator, "" for items of other kinds."""
        if item.kind != "procedure" or item.started_id is None:
            return ""
        self._procedure_runs.interrupt(item.started_id, reason)
        return f"run {item.started_id} was interrupted; resume it on the page Procedures"

    def stop(self, item: PlanItem, *, user: str) -> None:
        """Stop a run. A transfer is only paused, so its stored chunks remain usable."""
        if item.started_id is None:
            return
        with contextlib.suppress(GssError):
            if item.kind == "procedure":
                self._procedure_runs.stop(item.started_id, "its pass plan ended", user=user)
            else:
                self._transfers.pause(item.started_id)
