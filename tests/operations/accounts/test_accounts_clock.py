"""A clock that is set back, or was temporarily ahead, makes no expired session or token valid."""

from __future__ import annotations

from datetime import timedelta
from types import SimpleNamespace

from gss.operations.accounts.accounts import open_account_service
from gss.operations.accounts.audit import AuditService
from gss.operations.accounts.audit_anchor import AnchorFile
from gss.store import choices

PASSWORD = "correct horse battery"
RULES = SimpleNamespace(password_passes=1, password_memory_kib=32, session_idle_minutes=60, session_hours=10)
DAY_S = 86400.0


class Seconds:
    """Monotonic clock, independent of the system clock."""

    def __init__(self) -> None:
        self.at_s = 0.0

    def __call__(self) -> float:
        return self.at_s


def test_a_clock_set_back_revives_neither_token_nor_session(database, clock):
    """If the system clock is set back while the server runs, expired tokens and sessions remain invalid, because the
    monotonic clock continues."""
    seconds = Seconds()
    accounts = open_account_service(database, RULES, clock, seconds)
    accounts.users.add("ann", "admin", by="test", password=PASSWORD)
    token = accounts.tokens.add("t", "viewer", 1, by="ann").key
    session = accounts.sessions.sign_in("ann", PASSWORD, address="a").key
    clock.forward(2 * DAY_S)
    seconds.at_s += 2 * DAY_S
    assert accounts.token_caller(token, "a") is None
    clock.forward(-2 * DAY_S)
    assert accounts.token_caller(token, "a") is None
    assert accounts.session_caller(session) is None
    assert accounts.session_caller(accounts.sessions.sign_in("ann", PASSWORD, address="a").key) is not None


def test_after_a_restart_with_a_clock_set_back_an_expired_token_stays_expired(database, clock, tmp_path):
    """After a restart, time is at least that of the newest audit row, or the last trusted time if newer rows have a wrong
    time."""
    accounts = open_account_service(database, RULES, clock, Seconds())
    token = accounts.tokens.add("t", "viewer", 1, by="ann").key
    audit = AuditService(database, clock, AnchorFile(tmp_path / "anchors"))
    clock.forward(2 * DAY_S)
    audit.record("ann", "x.y", "late", "done")
    clock.forward(-2 * DAY_S)
    assert open_account_service(database, RULES, clock, Seconds()).token_caller(token, "a") is None
    with database.unit_of_work() as session:
        trusted = clock.at + timedelta(days=2)
        choices.write(session, choices.TRUSTED_TIME, {"at": trusted.isoformat()}, clock.at, "gss")
    audit.record("ann", "x.y", "with the clock set back", "done")
    assert open_account_service(database, RULES, clock, Seconds()).token_caller(token, "a") is None


def test_keys_made_with_a_clock_ahead_are_not_valid_for_years(database, clock):
    """Keys created with a clock ten years ahead are rejected once the clock is correct; otherwise they would be valid for
    ten years."""
    clock.forward(3650 * DAY_S)
    accounts_ahead = open_account_service(database, RULES, clock, Seconds())
    accounts_ahead.users.add("ann", "admin", by="test", password=PASSWORD)
    token = accounts_ahead.tokens.add("t", "viewer", 1, by="ann").key
    session = accounts_ahead.sessions.sign_in("ann", PASSWORD, address="a").key
    assert accounts_ahead.token_caller(token, "a") is not None
    clock.forward(-3650 * DAY_S)
    correct = open_account_service(database, RULES, clock, Seconds())
    assert correct.token_caller(token, "a") is None
    assert correct.session_caller(session) is None
