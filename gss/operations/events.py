"""The event bus: events are recorded and published to all subscribers."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from datetime import datetime
from typing import Any

from gss.operations.clock import Now
from gss.store import events as store
from gss.store.engine import Database
from gss.store.models import Event

MAILBOX = 2000


@dataclass(frozen=True)
class Message:
    """A published message. ``topic`` defines the type of ``payload``. ``seq`` is set only for recorded events."""

    topic: str
    payload: Any
    seq: int | None = None


class Subscription:
    """The message queue of one listener. If it overflows, the oldest messages are dropped and counted."""

    def __init__(self, wake: Callable[[], None]) -> None:
        self._wake = wake
        self._messages: deque[Message] = deque(maxlen=MAILBOX)
        self._lock = threading.Lock()
        self._dropped = 0

    def put(self, message: Message) -> None:
        """Append a message. The bus calls this from any thread. The call never blocks."""
        with self._lock:
            if len(self._messages) == MAILBOX:
                self._dropped += 1
            self._messages.append(message)
        self._wake()

    def wake(self) -> None:
        """Wake the listener without sending a message."""
        self._wake()

    def take(self) -> tuple[list[Message], int]:
        """Remove and return all waiting messages, and the number of messages dropped before them."""
        with self._lock:
            messages, dropped = list(self._messages), self._dropped
            self._messages.clear()
            self._dropped = 0
        return messages, dropped


class EventBus:
    """Records events and delivers messages to subscriptions."""

    def __init__(self, database: Database, now: Now) -> None:
        self._database, self._now = database, now
        self._subscriptions: set[Subscription] = set()
        self._lock = threading.Lock()
        self._in_order = threading.Lock()

    def record(self, kind: str, severity: str, text: str, **data: Any) -> Event:
        """Record an event and publish it. Events are published in the order of their numbers. A client that reconnects with
        the last number it received therefore misses no event."""
        with self._in_order:
            with self._database.unit_of_work() as session:
                event = store.add(session, self._now(), kind, severity, text, data)
            self.publish("event", event, event.seq)
        return event

    def publish(self, topic: str, payload: Any, seq: int | None = None) -> None:
        """Publish a message without recording it."""
        with self._lock:
            subscriptions = list(self._subscriptions)
        for subscription in subscriptions:
            subscription.put(Message(topic, payload, seq))

    def wake_all(self) -> None:
        """Wake every listener, for example because the server is stopping."""
        with self._lock:
            subscriptions = list(self._subscriptions)
        for subscription in subscriptions:
            subscription.wake()

    def subscribe(self, wake: Callable[[], None]) -> Subscription:
        """Create a subscription. ``wake`` is called after each message, from any thread."""
        subscription = Subscription(wake)
        with self._lock:
            self._subscriptions.add(subscription)
        return subscription

    def unsubscribe(self, subscription: Subscription) -> None:
        """Remove a subscription."""
        with self._lock:
            self._subscriptions.discard(subscription)

    def after(self, seq: int, limit: int) -> list[Event]:
        """Return recorded events after ``seq``, oldest first."""
        with self._database.unit_of_work() as session:
            return store.after(session, seq, limit)

    def between(
        self, start: datetime | None, end: datetime | None, limit: int, after: int | None = None
    ) -> list[Event]:
        """Return at most ``limit`` recorded events of a time span, oldest first: the first after the number ``after``, or the
        latest. A number above the latest is of another database, as after a restore; then the latest are returned."""
        with self._database.unit_of_work() as session:
            known = after is not None and after <= store.last_seq(session)
            return store.between(session, start, end, limit, after if known else None)

    def newest(self) -> int:
        """Return the number of the latest recorded event, or 0 if there is none."""
        with self._database.unit_of_work() as session:
            return store.last_seq(session)
