"""Database access for commands that manage accounts. The server can run at the same time."""

from __future__ import annotations

import argparse
import contextlib
import getpass
import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from gss.operations.accounts.accounts import AccountService
    from gss.operations.accounts.audit import AuditService
    from gss.settings import Settings


@dataclass(frozen=True)
class AccountAdministration:
    """Accounts and audit log of a store. ``user``: name of the shell's user in the audit log."""

    accounts: AccountService
    audit: AuditService
    settings: Settings
    user: str

    def record(self, action: str, target: str, detail: str = "") -> None:
        """Write an audit row, as the server does for its requests."""
        self.audit.record(self.user, f"shell.{action}", target, "done", detail, role="shell")


def with_data(parser: argparse.ArgumentParser) -> argparse.ArgumentParser:
    """Add the option that selects the store."""
    parser.add_argument("--data", type=Path, help="data folder (GSS_DATA)")
    return parser


@contextlib.contextmanager
def account_store(arguments: argparse.Namespace) -> Iterator[AccountAdministration]:
    """Open the store. Create it if it does not exist, because the first user can be created before the first start of
    the server."""
    from gss.operations.accounts.accounts import open_account_service
    from gss.operations.accounts.audit import AuditService
    from gss.operations.accounts.audit_anchor import AnchorFile
    from gss.operations.clock import monotonic_s, utc_now
    from gss.operations.folder_lock import own_folder, private_files
    from gss.settings import Settings
    from gss.store.engine import Database, open_engine
    from gss.store.migration import migrate

    settings = Settings() if arguments.data is None else Settings(data=arguments.data)
    with private_files():
        own_folder(settings.data)
        migrate(settings.database_url)
        database = Database(open_engine(settings.database_url))
        try:
            accounts = open_account_service(database, settings, utc_now, monotonic_s)
            audit = AuditService(database, utc_now, AnchorFile(settings.audit_anchor_file))
            audit.begin_anchors()
            yield AccountAdministration(accounts, audit, settings, f"shell:{_user()}"[:60])
        finally:
            database.close()


def _user() -> str:
    try:
        return getpass.getuser()
    except (KeyError, OSError):
        return str(os.getuid())
