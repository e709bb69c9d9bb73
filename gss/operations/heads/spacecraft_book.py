"""Store of spacecraft with several heads: check, add, change and delete them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gss.domain.angles import ARCSEC_RAD
from gss.domain.errors import Conflict, NotFound
from gss.domain.rotation import turned
from gss.operations.clock import Now
from gss.operations.events import EventBus
from gss.operations.heads.mountings import SpacecraftRequest, SpacecraftSetup, head_columns, row_values, setup_of
from gss.operations.heads.tracker import PairResult
from gss.store import heads as store
from gss.store.engine import Database
from gss.store.models import Spacecraft

MAX_SPACECRAFT = 16


class SpacecraftBook:
    """Stores spacecraft. A changed spacecraft restarts its misalignment estimates."""

    def __init__(self, database: Database, bus: EventBus, now: Now) -> None:
        self._database, self._bus, self._now = database, bus, now

    def list_all(self) -> list[SpacecraftSetup]:
        """Return all spacecraft, sorted by name."""
        with self._database.unit_of_work() as session:
            return [setup_of(row) for row in store.list_all(session)]

    def get(self, spacecraft_id: int) -> SpacecraftSetup:
        """Return the spacecraft with that id. Raises NotFound."""
        with self._database.unit_of_work() as session:
            return setup_of(store.get(session, spacecraft_id))

    def named(self, name: str) -> SpacecraftSetup:
        """Return the spacecraft with that name. Raises NotFound that lists the existing names."""
        setups = self.list_all()
        setup = next((candidate for candidate in setups if candidate.name == name), None)
        if setup is None:
            names = " | ".join(candidate.name for candidate in setups)
            raise NotFound("no such spacecraft", expected=names or "a spacecraft; none is stored", got=name)
        return setup

    def create(self, request: SpacecraftRequest, *, user: str) -> SpacecraftSetup:
        """Store a new spacecraft. Raises Conflict if its name or one of its units is already used."""
        with self._database.unit_of_work() as session:
            others = [setup_of(stored) for stored in store.list_all(session)]
            if len(others) >= MAX_SPACECRAFT:
                raise Conflict("too many spacecraft", expected=f"at most {MAX_SPACECRAFT}", hint="Delete one.")
            row = Spacecraft(**row_values(request), user=user, changed=self._now())
            _check_free(setup_of(row), others)
            store.add(session, row)
            setup = setup_of(row)
        self._bus.record("heads", "ok", f"{user} added the spacecraft {setup.name} with {_units(setup)}")
        return setup

    def change(self, spacecraft_id: int, request: SpacecraftRequest, *, user: str) -> SpacecraftSetup:
        """Replace all values of a spacecraft. Raises NotFound, and Conflict as :meth:`create` does."""
        with self._database.unit_of_work() as session:
            row = store.get(session, spacecraft_id)
            others = [setup_of(stored) for stored in store.list_all(session) if stored.id != spacecraft_id]
            for name, value in row_values(request).items():
                setattr(row, name, value)
            row.user, row.changed = user, self._now()
            setup = setup_of(row)
            _check_free(setup, others)
        self._bus.record("heads", "ok", f"{user} changed the spacecraft {setup.name} with {_units(setup)}")
        return setup

    def remove(self, spacecraft_id: int, *, user: str) -> None:
        """Delete a spacecraft with its history. Raises NotFound."""
        with self._database.unit_of_work() as session:
            name = store.get(session, spacecraft_id).name
            store.remove(session, spacecraft_id)
        self._bus.record("heads", "ok", f"{user} deleted the spacecraft {name}")

    def correct(self, spacecraft_id: int, pair: PairResult, *, user: str) -> SpacecraftSetup:
        """Correct the mounting of a head by its estimated misalignment. The uncertainty of the estimate becomes the uncertainty
        of the mounting. Raises NotFound."""
        with self._database.unit_of_work() as session:
            row = store.get(session, spacecraft_id)
            setup = setup_of(row)
            head = setup.head(pair.unit)
            if head is None:
                raise NotFound(f"{setup.name} has no such head", expected=_units(setup), got=pair.unit)
            vector = pair.misalignment.vector_rad
            corrected = replace(
                head, body_from_cam=turned(head.body_from_cam, vector), sigma_rad=float(np.max(pair.sigma_rad))
            )
            row.heads = [head_columns(corrected if other is head else other) for other in setup.heads]
            row.user, row.changed = user, self._now()
            setup = setup_of(row)
        angle = float(np.linalg.norm(vector)) / ARCSEC_RAD
        self._bus.record(
            "heads", "watch", f"{user} corrected the mounting of {pair.unit} on {setup.name} by {angle:.1f}″"
        )
        return setup


def _units(setup: SpacecraftSetup) -> str:
    return ", ".join(head.unit for head in setup.heads)


def _check_free(setup: SpacecraftSetup, others: list[SpacecraftSetup]) -> None:
    if any(other.name.lower() == setup.name.lower() for other in others):
        raise Conflict(
            "a spacecraft with this name exists", got=setup.name, hint="Choose another name, or edit that one."
        )
    mounted = {head.unit: other.name for other in others for head in other.heads}
    for head in setup.heads:
        if head.unit in mounted:
            raise Conflict(
                "the unit belongs to another spacecraft",
                got=f"{head.unit} on {mounted[head.unit]}",
                hint="Remove it there.",
            )
