"""Services of users, permissions, the audit log and shared views."""

from __future__ import annotations

from dataclasses import dataclass

from gss.operations.accounts.accounts import AccountService, open_account_service
from gss.operations.accounts.audit import AuditService
from gss.operations.accounts.audit_anchor import AnchorFile
from gss.operations.accounts.audit_intents import AuditIntents
from gss.operations.clock import monotonic_s, utc_now
from gss.operations.views.shared_views import SharedViews
from gss.store.engine import Database, open_engine
from gss.wiring.base import BaseServices


@dataclass(frozen=True)
class Accounts:
    """Services of users with their sessions and tokens, of the audit log, and of shared views of the console."""

    accounts: AccountService
    audit: AuditService
    intents: AuditIntents
    views: SharedViews


def open_accounts(base: BaseServices) -> Accounts:
    """Create the services. The accounts can be in a separate database."""
    settings = base.settings
    database = Database(open_engine(settings.accounts)) if settings.accounts else base.database
    accounts = open_account_service(database, settings, utc_now, monotonic_s)
    audit = AuditService(base.database, utc_now, AnchorFile(settings.audit_anchor_file))
    views = SharedViews(base.database, base.clock.now)
    return Accounts(accounts, audit, AuditIntents(settings.data / "audit-intents", audit), views)
