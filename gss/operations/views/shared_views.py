"""Stores shared views: pages of the console with their state in the address, each with an owner and versions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from pydantic import Field

from gss.domain.errors import BadInput, Conflict, NotPermitted
from gss.operations.clock import Now
from gss.operations.requests import MAX_PATH_LENGTH, Request, check_page_path
from gss.store import views as store
from gss.store.engine import Database
from gss.store.models import SharedView, SharedViewVersion

MAX_VIEWS, MAX_VERSIONS = 500, 50


class ViewRequest(Request):
    """View to store. ``path``: address of a page within the unit, with its query; ``open``: every user with the
    permission may change it."""

    name: str = Field(min_length=1, max_length=80)
    path: str = Field(min_length=1, max_length=MAX_PATH_LENGTH)
    note: str = Field(default="", max_length=500)
    open: bool = False


@dataclass(frozen=True)
class ViewDetail:
    """A view and its versions, latest version first."""

    row: SharedView
    versions: Sequence[SharedViewVersion]


class SharedViews:
    """Stores shared views. ``manages``, a parameter of its methods, is true if the user may change the views of other
    users."""

    def __init__(self, database: Database, now: Now) -> None:
        self._database, self._now = database, now

    def list_all(self) -> list[SharedView]:
        """Return all views, by name."""
        with self._database.unit_of_work() as session:
            return store.list_all(session)

    def get(self, view_id: int) -> ViewDetail:
        """Return a view with its versions. Raises NotFound."""
        with self._database.unit_of_work() as session:
            return ViewDetail(store.get(session, view_id), store.versions(session, view_id))

    def create(self, content: ViewRequest, *, user: str) -> SharedView:
        """Store a new view. Raises BadInput for an address outside the console, Conflict if the name is in use."""
        checked = _checked(content)
        with self._database.unit_of_work() as session:
            if store.count(session) >= MAX_VIEWS:
                raise Conflict("There are too many views", expected=f"at most {MAX_VIEWS}", hint="Delete one.")
            _check_name(store.named(session, checked.name), None)
            row = SharedView(owner=user, version=0)
            self._fill(row, checked, user)
            store.add(session, row)
            store.add(session, _version_of(row))
        return row

    def change(self, view_id: int, version: int, content: ViewRequest, *, user: str, manages: bool) -> SharedView:
        """Store a new version of a view. ``version``: the one that the user saw. Raises NotFound, NotPermitted,
        BadInput, and Conflict if another user has changed the view since."""
        checked = _checked(content)
        with self._database.unit_of_work() as session:
            row = store.get(session, view_id, lock=True)
            _check_owner(row, user, manages=manages)
            if row.version != version:
                raise Conflict(
                    "The view has changed since you opened it",
                    expected=f"version {row.version}, of {row.user}",
                    got=f"version {version}",
                    hint="Open the latest version and change it.",
                )
            if checked.open != row.open and row.owner != user and not manages:
                raise NotPermitted("Only the owner chooses who may change a view", expected=row.owner, got=user)
            _check_name(store.named(session, checked.name), row)
            self._fill(row, checked, user)
            store.add(session, _version_of(row))
            store.forget_versions(session, row.id, row.version - MAX_VERSIONS + 1)
        return row

    def remove(self, view_id: int, *, user: str, manages: bool) -> None:
        """Delete a view with its versions. Raises NotFound, and NotPermitted for a view of another user."""
        with self._database.unit_of_work() as session:
            row = store.get(session, view_id, lock=True)
            if row.owner != user and not manages:
                raise NotPermitted("Only the owner deletes a view", expected=row.owner, got=user)
            store.remove(session, row)

    def _fill(self, row: SharedView, content: ViewRequest, user: str) -> None:
        row.name, row.path, row.note, row.open = content.name, content.path, content.note, content.open
        row.version, row.user, row.changed = row.version + 1, user, self._now()


def _checked(content: ViewRequest) -> ViewRequest:
    """Return the content if its name can be shown and its path is a page of this console. Raises BadInput."""
    name, path = " ".join(content.name.split()), content.path
    if not name or not name.isprintable():
        raise BadInput(
            "The name of the view contains unprintable characters or is empty",
            expected="printable characters",
            got=content.name[:40],
        )
    check_page_path(path)
    if path.startswith("/views"):
        raise BadInput("A view cannot open another view", expected="the address of a page with data", got=path[:80])
    return ViewRequest(name=name, path=path, note=content.note.strip(), open=content.open)


def _check_owner(row: SharedView, user: str, *, manages: bool) -> None:
    if not (row.open or manages or row.owner == user):
        raise NotPermitted(
            "Only the owner may change this view", expected=row.owner, got=user, hint="Store it under another name."
        )


def _check_name(other: SharedView | None, row: SharedView | None) -> None:
    if other is not None and other is not row:
        raise Conflict("A view with this name exists", got=other.name, hint="Choose another name, or change that view.")


def _version_of(row: SharedView) -> SharedViewVersion:
    return SharedViewVersion(
        view_id=row.id,
        version=row.version,
        name=row.name,
        path=row.path,
        note=row.note,
        user=row.user,
        changed=row.changed,
    )
