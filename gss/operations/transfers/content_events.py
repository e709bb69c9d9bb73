"""Events of transfers: content that arrived, completely or in part. Subscribers store it and return links to the rows
created."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Future
from dataclasses import dataclass, field
from typing import Any

from gss.device.session_events import TransferDone, TransferUpdate
from gss.domain.errors import GssError
from gss.operations.line.line_events import ServiceEvent
from gss.store.models import Transfer

Links = dict[str, Any]
"""Columns of the transfer's row that refer to rows created from its content, such as ``frame_id``."""


@dataclass(frozen=True)
class Later:
    """Links that become available when ``job`` has stored the content: ``links`` of its result, called on the dispatcher's
    thread."""

    job: Future[Any]
    links: Callable[[Any], Links]


class Answers:
    """Collects the links that the subscribers return for a piece of content."""

    def __init__(self) -> None:
        self._now: list[Links] = []
        self._later: list[Later] = []
        self._errors: list[GssError] = []

    def accept(self, store: Callable[[], Links | Later]) -> None:
        """Store the content. A GssError means that the content cannot be used; it is reported with the transfer."""
        try:
            answer = store()
        except GssError as error:
            self._errors.append(error)
            return
        if isinstance(answer, Later):
            self._later.append(answer)
        else:
            self._now.append(answer)

    def ready(self) -> bool:
        """True if all storing jobs are done."""
        return all(later.job.done() for later in self._later)

    def links(self) -> Links:
        """Return all links. Raises the first storing error."""
        if self._errors:
            raise self._errors[0]
        found: Links = {}
        for links in [*self._now, *(later.links(later.job.result()) for later in self._later)]:
            found |= links
        return found


@dataclass(frozen=True)
class ContentArrived(ServiceEvent):
    """A transfer is complete, in either direction. Its row is closed when all subscribers' answers are ready."""

    transfer: Transfer
    done: TransferDone
    answers: Answers = field(default_factory=Answers, compare=False)


@dataclass(frozen=True)
class PartArrived(ServiceEvent):
    """A download broke off. ``data``: (size,) bytes with zeros where chunks are missing; ``held``: ranges of chunks."""

    transfer: Transfer
    data: bytes
    held: Sequence[tuple[int, int]]
    update: TransferUpdate
    answers: Answers = field(default_factory=Answers, compare=False)
