"""Shared views: console pages with their state, stored under a name."""

from __future__ import annotations

from gss.api.api_router import api_router
from gss.api.deps import App, AuditNote, CurrentUser, RowId, User, need
from gss.api.schemas.views import ViewChangeIn, ViewDetailOut, ViewOut, ViewVersionOut
from gss.operations.accounts.identity import CallerIdentity
from gss.operations.views.shared_views import ViewRequest

router = api_router("views", "/views")
MANAGE_PERMISSION = "admin.users"
NEED = need("views")


@router.get("")
def list_views(app: App) -> list[ViewOut]:
    """Stored views, by name."""
    return [ViewOut.model_validate(row) for row in app.accounts.views.list_all()]


@router.post("", status_code=201, dependencies=[NEED])
def create_view(app: App, body: ViewRequest, user: User, audit_note: AuditNote) -> ViewOut:
    """Store a page with its state under a name."""
    audit_note(body.name, body.path[:200])
    return ViewOut.model_validate(app.accounts.views.create(body, user=user))


@router.get("/{view_id}")
def read_view(app: App, view_id: RowId) -> ViewDetailOut:
    """View with its versions."""
    detail = app.accounts.views.get(view_id)
    versions = [ViewVersionOut.model_validate(version) for version in detail.versions]
    return ViewDetailOut(**ViewOut.model_validate(detail.row).model_dump(), versions=versions)


@router.put("/{view_id}", dependencies=[NEED])
def change_view(app: App, view_id: RowId, body: ViewChangeIn, caller: CurrentUser, audit_note: AuditNote) -> ViewOut:
    """Store a new version of a view. 409 if another user has changed the view in the meantime."""
    audit_note(body.name, f"from version {body.version}", body.path[:200])
    row = app.accounts.views.change(view_id, body.version, body, user=caller.name, manages=_manages(caller))
    return ViewOut.model_validate(row)


@router.delete("/{view_id}", status_code=204, dependencies=[NEED])
def delete_view(app: App, view_id: RowId, caller: CurrentUser, audit_note: AuditNote) -> None:
    """Delete a view with its versions."""
    audit_note(app.accounts.views.get(view_id).row.name)
    app.accounts.views.remove(view_id, user=caller.name, manages=_manages(caller))


def _manages(caller: CallerIdentity) -> bool:
    return caller.may(MANAGE_PERMISSION)
