"""Notification targets, rules and messages."""

from __future__ import annotations

from pydantic import AwareDatetime, BaseModel, Field


class TargetOut(BaseModel):
    """Target of notifications, without its secret."""

    name: str
    kind: str = Field(description="mail or webhook")
    host: str
    recipients: list[str]


class RuleOut(BaseModel):
    """Rule with its description."""

    name: str
    text: str


class NotificationOut(BaseModel):
    """Message to one target. ``state``: pending, sending, sent, failed, withdrawn or unknown."""

    id: int
    rule: str
    target: str
    level: str
    text: str
    alarm_id: int | None
    created: AwareDatetime
    due: AwareDatetime
    state: str
    tries: int
    problem: str
    finished: AwareDatetime | None


class NotificationsOut(BaseModel):
    """Targets, rules and the latest messages, newest first."""

    targets: list[TargetOut]
    rules: list[RuleOut]
    newest: list[NotificationOut]


class TestIn(BaseModel):
    """Target of a test message."""

    target: str = Field(min_length=1, max_length=40)
