"""Errors of the client, all subclasses of ``ClientError``. The text states what happened and, if the server knows it,
what to do."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from gss.client.records import Command, Job, ProcedureRun, Transfer


class ClientError(Exception):
    """Raised when the server rejects a request. ``status``: HTTP status; 0 if there was no response."""

    def __init__(self, message: str, status: int = 0) -> None:
        super().__init__(message)
        self.status = status


class NotAllowed(ClientError):
    """Raised when the token is missing, expired, or lacks the permission."""


class ServerAway(ClientError):
    """Raised when the server does not respond in time. A request that changes something may have been executed."""


class TimedOut(ClientError):
    """Raised when a wait reaches its timeout."""


class CommandFailed(ClientError):
    """Raised when a command does not complete."""

    def __init__(self, command: Command) -> None:
        super().__init__(f"{command.text}: {command.result}. {command.detail}".rstrip(". ") + ".")
        self.command = command


class TransferFailed(ClientError):
    """Raised when a transfer ends before it is complete."""

    def __init__(self, transfer: Transfer) -> None:
        super().__init__(f"Transfer {transfer.id} ({transfer.subject}): {transfer.state}. {transfer.reason}".rstrip())
        self.transfer = transfer


class JobFailed(ClientError):
    """Raised when a job fails or is cancelled."""

    def __init__(self, job: Job) -> None:
        super().__init__(f"Job {job.id} ({job.title}): {job.state}. {job.text}".rstrip())
        self.job = job


class ProcedureFailed(ClientError):
    """Raised when a procedure ends before its last step, or needs a person. ``run``: state of the run."""

    def __init__(self, run: ProcedureRun, reason: str) -> None:
        super().__init__(f"Procedure {run.name}, step {run.current or 'none'}: {reason}".rstrip(". ") + ".")
        self.run = run
