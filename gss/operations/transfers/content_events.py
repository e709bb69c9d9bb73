"""Events of transfers: content that arrived, completely or in part. Subscribers store it and return links to the rows
created."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Future
from dataclasses import dataclass, field
from typing import Any

from gss.device.session_events import TransferDone, TransferUpdate
from gss.domain.errors import StoreDown
from gss.operations.line.line_events import ServiceEvent
from gss.store.models import Transfer

Links = dict[str, Any]
"""Columns of the transfer's row that refer to rows created from its content, such as ``frame_id``."""


MOST_TRIES = 3
"""Tries to store a piece of content while the store is down."""


class Later:
    """Links that are known when ``work`` has stored the content: ``links`` of its result, called on the dispatcher's thread."""

    def __init__(
        self,
        submit: Callable[[Callable[[], Any]], Future[Any]],
        work: Callable[[], Any],
        links: Callable[[Any], Links],
    ) -> None:
        self._submit, self._work, self._links, self._tries = submit, work, links, 1
        self._job = submit(work)

    def done(self) -> bool:
        """True if the work ended."""
        return self._job.done()

    def start_again(self) -> bool:
        """Try once more if the store was down. False if it was not, or if it was tried often enough."""
        if not isinstance(self._job.exception(), StoreDown) or self._tries >= MOST_TRIES:
            return False
        self._tries += 1
        self._job = self._submit(self._work)
        return True

    def result(self) -> Links:
        """The links. Raises what storing raised."""
        return self._links(self._job.result())


class Answers:
    """Collects the links that the subscribers return for a piece of content."""

    def __init__(self) -> None:
        self._now: list[Links] = []
        self._later: list[Later] = []
        self._errors: list[Exception] = []

    def accept(self, store: Callable[[], Links | Later]) -> None:
        """Store the content. An error means that it cannot be used; it is reported with the transfer."""
        try:
            answer = store()
        except Exception as error:  # whatever it is, the transfer must not be reported as complete
            self._errors.append(error)
            return
        if isinstance(answer, Later):
            self._later.append(answer)
        else:
            self._now.append(answer)

    def ready(self) -> bool:
        """True if all storing jobs are done; those that met a store that is down are started again."""
        return all(later.done() and not later.start_again() for later in self._later)

    @property
    def missing(self) -> bool:
        """True if no subscriber answered."""
        return not (self._now or self._later or self._errors)

    def links(self) -> Links:
        """Return all links. Raises the first storing error."""
        if self._errors:
            raise self._errors[0]
        found: Links = {}
        for links in [*self._now, *(later.result() for later in self._later)]:
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
