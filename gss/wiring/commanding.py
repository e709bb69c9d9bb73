"""Services of commands and the schedule."""

from __future__ import annotations

from dataclasses import dataclass

from gss.operations.commanding.abort_journal import AbortJournal
from gss.operations.commanding.authority import AuthorityService
from gss.operations.commanding.command_history import CommandHistory
from gss.operations.commanding.commanding import CommandService
from gss.operations.commanding.schedule import ScheduleService
from gss.wiring.accounts import Accounts
from gss.wiring.base import BaseServices
from gss.wiring.line import Line


@dataclass(frozen=True)
class Commanding:
    """Services that send commands, and their history."""

    authority: AuthorityService
    commands: CommandService
    history: CommandHistory
    schedule: ScheduleService


def open_commanding(base: BaseServices, line: Line, accounts: Accounts) -> Commanding:
    """Create the commanding services."""
    database, bus, now, link = base.database, base.bus, base.clock.now, line.link
    authority = AuthorityService(database, bus, now)
    journal = AbortJournal(base.settings.data / "aborts.jsonl")
    commands = CommandService(link, database, bus, now, authority, accounts.accounts.require, journal)
    return Commanding(authority, commands, CommandHistory(database), ScheduleService(link, commands, bus, now))
