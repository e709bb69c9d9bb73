"""Notifications: targets, rules, sent messages and a test message."""

from __future__ import annotations

from gss.api.api_router import api_router
from gss.api.deps import App, AuditNote, User, need
from gss.api.schemas.notifications import NotificationOut, NotificationsOut, RuleOut, TargetOut, TestIn
from gss.store.models import Notification

router = api_router("notifications", "/notifications")
NEWEST = 200


@router.get("", dependencies=[need("admin.health")])
def list_notifications(app: App) -> NotificationsOut:
    """Targets and rules of the notification file, and the latest messages."""
    rules = app.notifications.rules
    return NotificationsOut(
        targets=[
            TargetOut(
                name=t.name,
                kind="mail" if t.mail else "webhook",
                host=t.host,
                recipients=list(t.mail.to) if t.mail else [],
            )
            for t in rules.targets
        ],
        rules=[RuleOut(name=rule.name, text=rule.words) for rule in rules.rules],
        newest=[_out(row) for row in app.notifications.newest(NEWEST)],
    )


@router.post("/test", status_code=202, dependencies=[need("admin.health")])
def send_test(app: App, user: User, body: TestIn, audit_note: AuditNote) -> NotificationOut:
    """Queue a test message to one target; it is sent within a minute."""
    audit_note(body.target)
    return _out(app.notifications.test(body.target, user=user))


def _out(row: Notification) -> NotificationOut:
    return NotificationOut.model_validate(row, from_attributes=True)
