"""Store of procedures, and checks of their texts. The procedures of the unit's instrument package are also available."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass

from gss.domain.errors import BadInput, Conflict
from gss.instruments.package import Instrument
from gss.operations.clock import Now, iso_z
from gss.operations.line.link import LinkService
from gss.operations.procedures.document import Mistake, ProcedureDocument, read_procedure
from gss.operations.procedures.validation import mistakes_of
from gss.operations.telemetry.field_definitions import TelemetryDefinitions
from gss.store import procedures as store
from gss.store.engine import Database
from gss.store.models import Procedure


@dataclass(frozen=True)
class ProcedureCheck:
    """Content of a procedure and its mistakes. A procedure without mistakes can start."""

    document: ProcedureDocument
    mistakes: Sequence[Mistake]


class ProcedureService:
    """Stores procedures. ``definitions``: telemetry fields that conditions can refer to."""

    def __init__(
        self, link: LinkService, unit: Instrument, definitions: TelemetryDefinitions, database: Database, now: Now
    ) -> None:
        self._link, self._unit, self._definitions = link, unit, definitions
        self._database, self._now = database, now

    def list_all(self) -> list[Procedure]:
        """Return all stored procedures, sorted by name."""
        with self._database.unit_of_work() as session:
            return store.list_all(session)

    def of_package(self) -> dict[str, str]:
        """Return the procedures in the unit's instrument package: file name to text."""
        return dict(self._unit.procedures)

    def get(self, procedure_id: int, sha256: str = "") -> Procedure:
        """Return the procedure with that id. ``sha256``: hash of the text that the caller has; "" accepts each text. Raises
        NotFound, and Conflict if the text has another hash."""
        with self._database.unit_of_work() as session:
            row = store.get(session, procedure_id)
        if sha256:
            self._check_text(row, sha256, "Open the procedure again and read its text.")
        return row

    def check(self, text: str) -> ProcedureCheck:
        """Read and check the text of a procedure. Raises BadInput if it is too long."""
        document = read_procedure(text)
        return ProcedureCheck(document, mistakes_of(document, self._link.roles.operations, self._definitions))

    def valid(self, procedure: Procedure) -> ProcedureDocument:
        """Return the content of a stored procedure for a run. Raises BadInput with the first mistake."""
        checked = self.check(procedure.text)
        if checked.mistakes:
            first = checked.mistakes[0]
            others = f" There are {len(checked.mistakes)} mistakes." if len(checked.mistakes) > 1 else ""
            raise BadInput(
                f"The procedure cannot start. Line {first.line}: {first.text}{others}",
                hint="correct it and save it again",
            )
        return checked.document

    def create(self, text: str, *, user: str) -> Procedure:
        """Store a procedure with its title as the name. The text can have mistakes, but must be correct before it starts. Raises
        BadInput, Conflict."""
        row = Procedure(name=self._name(text), text=text, author=user, changed=self._now())
        with self._database.unit_of_work() as session:
            self._check_free(store.named(session, row.name), None)
            store.add(session, row)
        return row

    def change(self, procedure_id: int, text: str, *, sha256: str, user: str) -> Procedure:
        """Replace the text of a procedure. ``sha256``: hash of the text that the user changed. Existing runs keep their copies of
        the text. Raises NotFound, BadInput, and Conflict if another user has changed it since."""
        with self._database.unit_of_work() as session:
            row = store.get(session, procedure_id, lock=True)
            self._check_text(row, sha256, "Copy your text, open the procedure again and change it.")
            name = self._name(text)
            self._check_free(store.named(session, name), row.id)
            row.name, row.text, row.author, row.changed = name, text, user, self._now()
        return row

    def delete(self, procedure_id: int) -> None:
        """Delete a procedure. The records of its runs remain stored. Raises NotFound."""
        with self._database.unit_of_work() as session:
            store.delete(session, procedure_id)

    @staticmethod
    def _check_text(row: Procedure, sha256: str, hint: str) -> None:
        if sha256 != hash_of(row.text):
            raise Conflict(
                "The procedure has changed since you opened it",
                expected=f"the text of {row.author}, {iso_z(row.changed)}",
                got="an earlier text",
                hint=hint,
            )

    @staticmethod
    def _name(text: str) -> str:
        title = read_procedure(text).title
        if not 1 <= len(title) <= 80:
            raise BadInput(
                "The title of the procedure is missing or too long",
                expected="a first line “# Title” of 1 – 80 characters",
                got=f"{len(title)} characters",
            )
        return title

    @staticmethod
    def _check_free(same_name: Procedure | None, own_id: int | None) -> None:
        if same_name is not None and same_name.id != own_id:
            raise Conflict(
                "A procedure with this title exists",
                got=same_name.name,
                hint="change its title, or edit that procedure",
            )


def hash_of(text: str) -> str:
    """Return the SHA-256 of the text of a procedure."""
    return hashlib.sha256(text.encode()).hexdigest()
