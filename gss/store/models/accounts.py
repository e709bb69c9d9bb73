"""Users, sessions, tokens, one-time links and the audit log. Secrets are stored only as hashes."""

from __future__ import annotations

from datetime import datetime
from typing import Any

from sqlalchemy import Connection, ForeignKey, Index, String, Table, Text, event
from sqlalchemy.orm import Mapped, mapped_column

from gss.store.models.base import Base


class User(Base):
    """User account. ``password_hash``: "" until the one-time link is used. ``disabled_reason``: "" while the account is
    enabled. ``start_page``: page that opens after sign-in; "" for the start page of the role."""

    __tablename__ = "users"
    id: Mapped[int] = mapped_column(primary_key=True)
    name: Mapped[str] = mapped_column(String(60), unique=True)
    role: Mapped[str] = mapped_column(String(20))
    enabled: Mapped[bool]
    password_hash: Mapped[str] = mapped_column(String(255))
    created: Mapped[datetime]
    created_by: Mapped[str] = mapped_column(String(60))
    password_changed: Mapped[datetime | None]
    last_sign_in: Mapped[datetime | None]
    disabled_reason: Mapped[str] = mapped_column(String(200), server_default="")
    start_page: Mapped[str] = mapped_column(Text, default="", server_default="")


class SignIn(Base):
    """Session of a browser. ``expires``: time at which the session ends. A period without requests ends it
    earlier. ``device_hash``: hash of the cookie that identifies the browser at a later sign-in."""

    __tablename__ = "sign_ins"
    __table_args__ = (
        Index("ix_sign_ins_user_id_ended", "user_id", "ended"),
        Index("ix_sign_ins_device_hash", "device_hash"),
    )
    id: Mapped[int] = mapped_column(primary_key=True)
    user_id: Mapped[int] = mapped_column(ForeignKey("users.id"))
    key_hash: Mapped[str] = mapped_column(String(64), unique=True)
    created: Mapped[datetime]
    last_seen: Mapped[datetime]
    expires: Mapped[datetime]
    ended: Mapped[datetime | None]
    end_reason: Mapped[str] = mapped_column(String(60))
    address: Mapped[str] = mapped_column(String(60))
    agent: Mapped[str] = mapped_column(String(200))
    device_hash: Mapped[str] = mapped_column(String(64), server_default="")


class ApiToken(Base):
    """API token. ``scopes``: permissions of the role to which the token is restricted; empty: all permissions of
    the role."""

    __tablename__ = "api_tokens"
    id: Mapped[int] = mapped_column(primary_key=True)
    name: Mapped[str] = mapped_column(String(50))
    role: Mapped[str] = mapped_column(String(20))
    scopes: Mapped[list[Any]]
    owner_id: Mapped[int | None] = mapped_column(ForeignKey("users.id"))
    key_hash: Mapped[str] = mapped_column(String(64), unique=True)
    created: Mapped[datetime]
    created_by: Mapped[str] = mapped_column(String(60))
    expires: Mapped[datetime]
    revoked: Mapped[datetime | None]
    last_used: Mapped[datetime | None]


class OneTimeLink(Base):
    """One-time link. ``kind``: setup (creates the first user) or password (sets the password of ``user_id``).
    ``created_by``: "" if the server created the link."""

    __tablename__ = "one_time_links"
    id: Mapped[int] = mapped_column(primary_key=True)
    kind: Mapped[str] = mapped_column(String(12))
    user_id: Mapped[int | None] = mapped_column(ForeignKey("users.id"))
    key_hash: Mapped[str] = mapped_column(String(64), unique=True)
    created: Mapped[datetime]
    expires: Mapped[datetime]
    used: Mapped[datetime | None]
    created_by: Mapped[str] = mapped_column(String(60), server_default="")


class AuditRow(Base):
    """Row of the audit log. Triggers prevent changes and deletion. ``hash`` covers the row and ``previous``, which is
    the hash of the previous row. ``previous`` is unique, so that two rows cannot follow the same row."""

    __tablename__ = "audit"
    __table_args__ = (Index("ix_audit_who_seq", "who", "seq"), Index("ix_audit_action_seq", "action", "seq"))
    seq: Mapped[int] = mapped_column(primary_key=True, autoincrement=False)
    at: Mapped[datetime]
    who: Mapped[str] = mapped_column(String(80))
    role: Mapped[str] = mapped_column(String(20))
    action: Mapped[str] = mapped_column(String(60))
    target: Mapped[str] = mapped_column(String(200))
    result: Mapped[str] = mapped_column(String(10))
    detail: Mapped[str] = mapped_column(Text)
    address: Mapped[str] = mapped_column(String(60))
    previous: Mapped[str] = mapped_column(String(64), unique=True)
    hash: Mapped[str] = mapped_column(String(64))


AUDIT_TRIGGERS = {
    "sqlite": (
        "CREATE TRIGGER audit_no_update BEFORE UPDATE ON audit BEGIN SELECT RAISE(ABORT, 'the audit record is append-only'); END",
        "CREATE TRIGGER audit_no_delete BEFORE DELETE ON audit BEGIN SELECT RAISE(ABORT, 'the audit record is append-only'); END",
        # INSERT OR REPLACE would delete a row without firing the DELETE trigger.
        "CREATE TRIGGER audit_no_replace BEFORE INSERT ON audit "
        "WHEN EXISTS (SELECT 1 FROM audit WHERE seq = NEW.seq OR previous = NEW.previous) "
        "BEGIN SELECT RAISE(ABORT, 'the audit record is append-only'); END",
    ),
    "postgresql": (
        "CREATE FUNCTION audit_only_grows() RETURNS trigger LANGUAGE plpgsql AS "
        "$$ BEGIN RAISE EXCEPTION 'the audit record is append-only'; END $$",
        "CREATE TRIGGER audit_no_change BEFORE UPDATE OR DELETE ON audit "
        "FOR EACH ROW EXECUTE FUNCTION audit_only_grows()",
        "CREATE TRIGGER audit_no_truncate BEFORE TRUNCATE ON audit "
        "FOR EACH STATEMENT EXECUTE FUNCTION audit_only_grows()",
    ),
}
"""SQL statements by type of database. They run after the audit table is created."""


@event.listens_for(AuditRow.__table__, "after_create")
def _create_triggers(_table: Table, connection: Connection, **_options: Any) -> None:
    for statement in AUDIT_TRIGGERS[connection.dialect.name]:
        connection.exec_driver_sql(statement)
