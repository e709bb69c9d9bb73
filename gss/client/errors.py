"""Errors of the client. All are ``ClientError``; the text says what happened and, where the server knows it, what to do."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from gss.client.records import Command, Job, ProcedureRun, Transfer


class ClientError(Exception):
    """The server rejected a request. ``status``: HTTP status; 0 if there was no response."""

    def __init__(self, message: str, status: int = 0) -> None:
        super().__init__(message)
        self.status = status


class NotAllowed(ClientError):
    """The token is missing, expired, or lacks the permission."""


class ServerAway(ClientError):
    """The server did not answer in time. A request that changes something may have been executed."""


class TimedOut(ClientError):
    """A wait reached its timeout."""


class CommandFailed(ClientError):
    """A command did not complete."""

    def __init__(self, command: Command) -> None:
        super().__init__(f"{command.text}: {command.result}. {command.detail}".rstrip(". ") + ".")
        self.command = command


class TransferFailed(ClientError):
    """A transfer ended before it was complete."""

    def __init__(self, transfer: Transfer) -> None:
        super().__init__(f"Transfer {transfer.id} ({transfer.subject}): {transfer.state}. {transfer.reason}".rstrip())
        self.transfer = transfer


class JobFailed(ClientError):
    """A job failed or was cancelled."""

    def __init__(self, job: Job) -> None:
        super().__init__(f"Job {job.id} ({job.title}): {job.state}. {job.text}".rstrip())
        self.job = job


class ProcedureFailed(ClientError):
    """A procedure ended before its last step, or needs a person. ``run``: the run as it is then."""

    def __init__(self, run: ProcedureRun, why: str) -> None:
        super().__init__(f"Procedure {run.name}, step {run.current or 'none'}: {why}".rstrip(". ") + ".")
        self.run = run
