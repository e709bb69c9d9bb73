"""Checklists of contacts and hand-over notes."""

from __future__ import annotations

from gss.api.api_router import api_router
from gss.api.deps import App, AuditNote, CurrentUser, RowId, User, need
from gss.api.schemas.handover import CheckIn, HandoverNoteIn, HandoverNoteOut, HandoverOut
from gss.domain.errors import Conflict
from gss.operations.contacts.handover import CheckedItem, Checklist, ChecklistRequest

router = api_router("contacts")
NEED = need("contacts.note")


@router.get("/checklist")
def read_checklist(app: App) -> Checklist:
    """Items to check in each contact."""
    return app.contacts.handover.checklist()


@router.put("/checklist", dependencies=[NEED])
def change_checklist(app: App, user: User, body: ChecklistRequest, audit_note: AuditNote) -> Checklist:
    """Change the items for open and later contacts. 409 if another user has changed them in the meantime."""
    audit_note(f"from version {body.version}:", "; ".join(body.items)[:400])
    return app.contacts.handover.change_checklist(body, user=user)


@router.get("/contacts/{contact_id}/handover")
def read_handover(app: App, contact_id: RowId) -> HandoverOut:
    """Checklist and hand-over notes of a contact."""
    return HandoverOut.model_validate(app.contacts.handover.of_contact(contact_id))


@router.put("/contacts/{contact_id}/checklist", dependencies=[NEED])
def check_item(app: App, user: User, contact_id: RowId, body: CheckIn, audit_note: AuditNote) -> CheckedItem:
    """Mark an item of a contact's checklist as done or not done."""
    audit_note("done:" if body.done else "not done:", body.item)
    return app.contacts.handover.check(contact_id, body.item, done=body.done, user=user)


@router.post("/contacts/{contact_id}/handover-notes", status_code=201, dependencies=[NEED])
def add_handover_note(
    app: App, user: User, contact_id: RowId, body: HandoverNoteIn, audit_note: AuditNote
) -> HandoverNoteOut:
    """Store a note to the next operator."""
    audit_note(body.text[:400])
    return HandoverNoteOut.model_validate(app.contacts.handover.add_note(contact_id, body.text, user=user))


@router.get("/handover-notes")
def read_unacknowledged_notes(app: App, user: User) -> list[HandoverNoteOut]:
    """The newest 50 hand-over notes of other users that are not acknowledged, oldest first."""
    return [HandoverNoteOut.model_validate(row) for row in app.contacts.handover.unacknowledged_notes(user)]


@router.post("/handover-notes/{note_id}/acknowledge", dependencies=[NEED])
def acknowledge_handover_note(app: App, caller: CurrentUser, note_id: RowId) -> HandoverNoteOut:
    """Record that the caller has read a note of another user."""
    if caller.kind != "session":
        raise Conflict("Tokens cannot acknowledge notes", expected="a signed-in user", hint="sign in")
    user = caller.name
    return HandoverNoteOut.model_validate(app.contacts.handover.acknowledge(note_id, user=user))
