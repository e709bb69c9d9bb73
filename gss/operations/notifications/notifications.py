"""Notification service. It creates notifications of alarms and events according to the rules, sends the notifications
on one thread per target, and records the results."""

from __future__ import annotations

import hashlib
import logging
import math
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, wait
from dataclasses import dataclass
from datetime import datetime, timedelta

from gss.domain.errors import NotFound
from gss.domain.limits import ORDER, State
from gss.operations.clock import Monotonic, Now
from gss.operations.events import EventBus
from gss.operations.notifications.rules_file import NotificationRule, NotificationRules, Target
from gss.operations.notifications.senders import OutgoingMessage
from gss.operations.telemetry.alarms import AlarmService
from gss.store import events as event_store
from gss.store import notifications as store
from gss.store.engine import Database
from gss.store.models import Alarm, Event, Notification

log = logging.getLogger("gss.notifications")
EVERY_S = 1.0
STOP_S = 1.0
MAX_TRIES = 8
FIRST_RETRY = timedelta(seconds=30)
LAST_RETRY = timedelta(minutes=15)
LINES = 40
"""Maximum number of notifications that one message lists. The message states the number of the notifications that it
does not list."""
KEPT = timedelta(days=90)
MAX_EVENTS = 500
"""Maximum number of events that one pass of the thread reads."""
Send = Callable[[Target, OutgoingMessage], str]


@dataclass(frozen=True)
class _Notification:
    """A notification that the rules require. ``key``: unique, so that the notification is created only once."""

    key: str
    rule: str
    target: str
    level: str
    text: str
    due: datetime
    alarm_id: int | None = None


class NotificationService:
    """Runs a thread that checks alarms and events once a second. ``send`` can block until its timeout. Each target has its
    own thread, so an unresponsive mail server or webhook delays only its own messages. If the server stops while a message is
    being sent, the message is marked as unknown and is not sent again."""

    def __init__(
        self,
        rules: NotificationRules,
        alarms: AlarmService,
        bus: EventBus,
        database: Database,
        now: Now,
        monotonic_s: Monotonic,
        send: Send,
    ) -> None:
        self.rules = rules
        self._alarms, self._bus, self._database, self._now, self._send = alarms, bus, database, now, send
        self._monotonic_s = monotonic_s
        self._pools: dict[str, ThreadPoolExecutor] = {}
        self._sending: dict[str, tuple[Future[str], tuple[int, ...]]] = {}
        self._last_sent_s: dict[str, float] = {}
        self._unanswered_since: dict[tuple[int, str], datetime] = {}
        self._seq, self._began = 0, False
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="notifications", daemon=True)

    def start(self) -> None:
        """Start the thread if there are targets. Only events after this call are sent. This call does not write to the
        database, because a locked database must not prevent the start of the server."""
        self._seq = self._bus.newest()
        if self.rules.targets:
            self._thread.start()

    def stop(self) -> None:
        """Stop the thread, and wait up to ``STOP_S`` for messages that are being sent."""
        self._stop.set()
        if self._thread.is_alive():
            self._thread.join(timeout=2)
        wait([job for job, _ in self._sending.values()], STOP_S)
        self._settle()
        for pool in self._pools.values():
            pool.shutdown(wait=False, cancel_futures=True)

    def newest(self, limit: int) -> list[Notification]:
        """Return the latest notifications, newest first."""
        with self._database.unit_of_work() as session:
            return store.newest(session, limit)

    def test(self, target: str, *, user: str) -> Notification:
        """Queue a test message to a target and return its row. Raises NotFound."""
        if self.rules.target(target) is None:
            raise NotFound("There is no such target", got=target, hint="the page Admin, Notifications lists them")
        now = self._now()
        notification = _Notification(
            f"test {target} {now.isoformat()}", "test", target, "ok", f"Test message by {user}.", now
        )
        (row,) = self._add([notification])
        return row

    def tick(self) -> None:
        """Create the notifications that the rules require now, withdraw those that are no longer needed, and send those that
        are due."""
        if not self._began:
            self._begin()
        self._settle()
        views = [view for view in self._alarms.opened() if view.row.acknowledged is None and not view.shelved]
        unanswered = [view.row for view in views]
        with self._database.unit_of_work() as session:
            store.withdraw_others(session, [row.id for row in unanswered], self._now())
        texts = {
            view.row.id: view.text if view.text.startswith(view.title) else f"{view.title}: {view.text}"
            for view in views
        }
        events = self._bus.after(self._seq, MAX_EVENTS)
        self._add([*self._of_alarms(unanswered, texts), *self._of_events(events)])
        if events:
            self._seq = events[-1].seq  # only now, so that a failing store does not lose these events
        self._send_due()

    def _begin(self) -> None:
        """Mark the messages that the previous server was sending as unknown, and delete old rows."""
        with self._database.unit_of_work() as session:
            store.lose_sending(session, self._now())
            store.prune(session, self._now() - KEPT)
        self._began = True

    def _run(self) -> None:
        while not self._stop.wait(EVERY_S):
            try:
                self.tick()
            except Exception:  # a locked database must not end the thread
                log.exception("notifications could not be handled")

    # --- what to send -------------------------------------------------------------------------------------------

    def _of_alarms(self, unanswered: Sequence[Alarm], texts: dict[int, str]) -> Iterator[_Notification]:
        now = self._now()
        since = {row.id: self._since(row) for row in unanswered}
        for rule in self.rules.rules:
            for row in unanswered:
                if rule.on == "alarm" and rule.covers(row.worst):
                    for step, target in _targets(rule, now - since[row.id]):
                        key = f"alarm {row.id} {row.worst} {rule.name} {step} {target}"
                        text = f"{texts[row.id]} (alarm {row.id}, raised {row.raised:%Y-%m-%d %H:%M:%SZ}"
                        text += (
                            ")" if step == 0 else f", not acknowledged for {rule.escalate[step - 1].after_min:g} min)"
                        )
                        yield _Notification(key, rule.name, target, row.worst, text, rule.due(row.worst, now), row.id)

    def _since(self, row: Alarm) -> datetime:
        """Return the time since which an alarm has not been acknowledged. A worse level resets an acknowledgement."""
        key = row.id, row.worst
        if key not in self._unanswered_since:
            since: datetime | None = row.raised
            with self._database.unit_of_work() as session:
                for event in event_store.of_alarm(session, row.id, row.raised):
                    since = None if event.data.get("state") == "acked" else since or event.at
            self._unanswered_since[key] = since or self._now()
        return self._unanswered_since[key]

    def _of_events(self, events: Sequence[Event]) -> Iterator[_Notification]:
        now = self._now()
        for event in events:
            for rule in self.rules.rules:
                if rule.on == "event" and event.kind in rule.kinds and rule.covers(event.severity):
                    for target in rule.to:
                        key = f"event {event.seq} {rule.name} {target}"
                        text = f"{event.text} ({event.kind}, {event.at:%Y-%m-%d %H:%M:%SZ})"
                        yield _Notification(key, rule.name, target, event.severity, text, rule.due(event.severity, now))

    def _add(self, messages: Sequence[_Notification]) -> list[Notification]:
        if not messages:
            return []
        now, by_key = self._now(), {message.key: message for message in messages}
        with self._database.unit_of_work() as session:
            states = store.states_by_key(session, list(by_key))
            # An alarm that is no longer shelved, or was raised again, needs its message again.
            for row in store.of_keys(session, [key for key, state in states.items() if state == "withdrawn"]):
                message = by_key[row.key]
                row.state, row.tries, row.problem, row.finished = "pending", 0, "", None
                row.text, row.due = message.text, message.due
            rows = [
                Notification(
                    key=message.key,
                    rule=message.rule,
                    target=message.target,
                    level=message.level,
                    text=message.text,
                    alarm_id=message.alarm_id,
                    created=now,
                    due=message.due,
                    state="pending",
                    tries=0,
                    problem="",
                )
                for message in by_key.values()
                if message.key not in states
            ]
            session.add_all(rows)
        return rows

    # --- sending ------------------------------------------------------------------------------------------------

    def _send_due(self) -> None:
        now, now_s = self._now(), self._monotonic_s()
        self._limit_waits(now)
        for target in self.rules.targets:
            last_s = self._last_sent_s.get(target.name, -math.inf)
            if target.name in self._sending or now_s - last_s < self.rules.pause_s:
                continue
            with self._database.unit_of_work() as session:
                rows = store.take_due(session, target.name, now)
            if rows:
                self._last_sent_s[target.name] = now_s
                pool = self._pools.setdefault(target.name, ThreadPoolExecutor(1, f"notify {target.name}"))
                job = pool.submit(self._send, target, self._message(rows))
                self._sending[target.name] = job, tuple(row.id for row in rows)

    def _limit_waits(self, now: datetime) -> None:
        """Limit the wait of each message to the one that it would have if it were created or retried now. A longer wait
        means that the server's clock was set back, possibly while the server was down."""
        rules = {rule.name: rule for rule in self.rules.rules}
        with self._database.unit_of_work() as session:
            for row in store.waiting(session, now):
                rule = rules.get(row.rule)  # None for a test message, or a rule that was removed from the file
                first_due = now if rule is None else rule.due(row.level, now)
                row.due = min(row.due, now + LAST_RETRY if row.tries else first_due)

    def _message(self, rows: Sequence[Notification]) -> OutgoingMessage:
        level = max((row.level for row in rows), key=lambda name: ORDER[State(name)])
        lines = [f"{row.level.upper()}: {row.text}" for row in rows[:LINES]]
        if len(rows) > LINES:
            lines.append(f"and {len(rows) - LINES} more, see the console")
        if self.rules.console:
            lines += ["", self.rules.console]
        first = f"[GSS] {level}: {rows[0].text}" if len(rows) == 1 else f"[GSS] {level}: {len(rows)} notifications"
        key = hashlib.sha256("\n".join(row.key for row in rows).encode()).hexdigest()[:32]
        return OutgoingMessage(key, level, first.replace("\n", " ")[:200], "\n".join(lines))

    def _settle(self) -> None:
        """Record the results of finished messages."""
        for target, (job, ids) in list(self._sending.items()):
            if job.done():
                self._finish(target, job, ids)

    def _finish(self, target: str, job: Future[str], ids: Sequence[int]) -> None:
        now, error = self._now(), job.exception() if not job.cancelled() else None
        with self._database.unit_of_work() as session:
            rows = [row for row in store.of_ids(session, ids) if row.state == "sending"]
            for row in rows:
                if error is None:
                    row.state, row.problem, row.finished = "sent", job.result(), now
                elif row.tries >= MAX_TRIES:
                    row.state, row.problem, row.finished = "failed", str(error), now
                else:
                    pause = min(FIRST_RETRY * 2 ** (row.tries - 1), LAST_RETRY)
                    row.state, row.problem, row.due = "pending", str(error), now + pause
            failed = sum(row.state == "failed" for row in rows)
        self._sending.pop(target, None)
        if error is None and job.result():
            self._bus.record(
                "notification", "warning", f"A notification to {target} did not reach all recipients: {job.result()}"
            )
        if failed:
            self._bus.record("notification", "warning", f"{failed} notifications to {target} were not sent: {error}")


def _targets(rule: NotificationRule, age: timedelta) -> Iterator[tuple[int, str]]:
    """Yield (step, target) for an alarm of this age: the rule's targets at step 0, then the targets of each due escalation."""
    yield from ((0, name) for name in rule.to)
    for step, further in enumerate(rule.escalate, 1):
        if age >= timedelta(minutes=further.after_min):
            yield from ((step, name) for name in further.to)
