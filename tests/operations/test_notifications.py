"""Notifications to a real mail server and a real webhook receiver: rules, escalation, failures and restarts."""

from __future__ import annotations

import hashlib
import hmac
import json
import socketserver
import sqlite3
import threading
from collections.abc import Iterator
from datetime import timedelta
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import pytest
from sqlalchemy.exc import IntegrityError

from gss.domain.errors import BadInput, NotFound, NotPermitted
from gss.domain.limits import State
from gss.instruments.dictionary.read_dictionary import load_dictionary
from gss.instruments.roles import default_roles
from gss.operations.line.dispatcher import LineEventQueue
from gss.operations.line.link import LinkService
from gss.operations.notifications.notifications import LAST_RETRY, MAX_TRIES, NotificationService
from gss.operations.notifications.rules_file import read_rules
from gss.operations.notifications.senders import OutgoingMessage, Sender, is_public
from gss.operations.telemetry.alarms import AlarmService
from gss.operations.telemetry.telemetry import TelemetryService

DICTIONARY = load_dictionary()
SECRET = "a long secret"
ENVIRONMENT = {"HOOK": SECRET}
DISK = ("store", "disk")


class Mailbox:
    """SMTP server on a loopback port that stores messages, rejects "gone@…", and responds to QUIT with an error.
    ``gate``: cleared while it accepts connections and does not respond."""

    def __init__(self) -> None:
        self.letters: list[str] = []
        self.gate = threading.Event()
        self.gate.set()
        letters, gate = self.letters, self.gate

        class Handler(socketserver.StreamRequestHandler):
            def handle(self) -> None:
                gate.wait()
                self.wfile.write(b"220 ready\r\n")
                while line := self.rfile.readline():
                    word = line[:4].upper()
                    if word == b"DATA":
                        self.wfile.write(b"354 send data\r\n")
                        letters.append("".join(iter(lambda: self.rfile.readline().decode(), ".\r\n")))
                    answer = b"421 no" if word == b"QUIT" else b"550 gone" if b"TO:<gone@" in line else b"250 ok"
                    self.wfile.write(answer + b"\r\n")

        self.server = socketserver.ThreadingTCPServer(("127.0.0.1", 0), Handler)
        self.port = self.server.server_address[1]
        threading.Thread(target=self.server.serve_forever, args=(0.05,), daemon=True).start()


class Receiver:
    """Webhook receiver. ``status``: status of its responses; ``gate``: cleared while it does not respond."""

    def __init__(self) -> None:
        self.bodies: list[dict[str, Any]] = []
        self.headers: list[dict[str, str]] = []
        self.status, self.gate = 200, threading.Event()
        self.gate.set()
        receiver = self

        class Handler(BaseHTTPRequestHandler):
            def do_POST(self) -> None:
                data = self.rfile.read(int(self.headers["Content-Length"]))
                receiver.bodies.append(json.loads(data))
                receiver.headers.append({**self.headers, "raw": data.decode()})
                receiver.gate.wait(30)
                self.send_response(receiver.status)
                self.end_headers()

            def log_message(self, *_: Any) -> None:
                """Print nothing."""

        self.server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self.port = self.server.server_address[1]
        threading.Thread(target=self.server.serve_forever, args=(0.05,), daemon=True).start()


@pytest.fixture
def mailbox() -> Iterator[Mailbox]:
    started = Mailbox()
    yield started
    started.gate.set()
    started.server.shutdown()
    started.server.server_close()


@pytest.fixture
def receiver() -> Iterator[Receiver]:
    started = Receiver()
    yield started
    started.gate.set()
    started.server.shutdown()
    started.server.server_close()


RULES = """
pause_s: 60
targets:
  - name: mail
    mail: {{server: 127.0.0.1, port: {mail}, security: none, sender: gss@example.org, to: [op@example.org]}}
  - name: hook
    webhook: {{url: "http://127.0.0.1:{hook}/in", secret_env: HOOK}}
rules:
  - name: alarms
    level: warning
    to: [hook]
    escalate: [{{after_min: 10, to: [mail]}}]
  - name: failures
    on: event
    kinds: [transfer]
    to: [hook]
"""


class Harness:
    """Alarms and notifications on a database with a settable clock; ``look`` is one pass of the thread."""

    def __init__(self, database, bus, clock, folder: Path, rules: str) -> None:
        self.database, self.bus, self.clock, self.set_back_s = database, bus, clock, 0.0
        self.link = LinkService(
            DICTIONARY,
            default_roles(DICTIONARY),
            database,
            bus,
            folder,
            clock,
            lambda: 0.0,
            LineEventQueue(clock, lambda: 0.0),
        )
        telemetry = TelemetryService(
            DICTIONARY, database, bus, clock, lambda: None, lambda: True, default_roles(DICTIONARY).quantities.status
        )
        self.alarms = AlarmService(DICTIONARY, telemetry, self.link, database, bus, clock)
        self.alarms.start()
        self.file = folder / "notifications.yaml"
        self.file.write_text(rules)
        self.service = self.new_service()

    def new_service(self) -> NotificationService:
        """Return the service of a server that starts now, without its thread."""
        rules = read_rules(str(self.file), ENVIRONMENT)
        service = NotificationService(
            rules,
            self.alarms,
            self.bus,
            self.database,
            self.clock,
            lambda: self.clock.at.timestamp() + self.set_back_s,
            Sender(True, ENVIRONMENT).send,
        )
        service._thread.start = lambda: None  # type: ignore[method-assign]
        service.start()
        return service

    def raise_alarm(self, state: State = State.WARNING) -> None:
        self.alarms.watch(DISK, state, 1.0, "Disk: nearly full", "nearly full")

    def set_clock_back(self, seconds: float) -> None:
        """Set the clock back; the monotonic clock continues."""
        self.clock.forward(-seconds)
        self.set_back_s += seconds

    def look(self, after_s: float = 0.0) -> dict[str, str]:
        """Advance the clock, run a pass, wait for messages being sent, and run another. Return each row's state by key."""
        self.clock.forward(after_s)
        self.service.tick()
        for job, _ in list(self.service._sending.values()):
            job.exception(timeout=30)
        self.service.tick()
        return {row.key: row.state for row in self.service.newest(100)}


@pytest.fixture
def harness(database, bus, clock, tmp_path, mailbox, receiver) -> Iterator[Harness]:
    new_harness = Harness(database, bus, clock, tmp_path, RULES.format(mail=mailbox.port, hook=receiver.port))
    yield new_harness
    receiver.gate.set()
    new_harness.service.stop()


def test_an_alarm_is_sent_once_and_escalates_until_it_is_acknowledged(harness, mailbox, receiver):
    """An alarm is sent once to the webhook, with a signature, and by mail after ten minutes. After the acknowledgement
    nothing is sent."""
    harness.raise_alarm()
    harness.look()
    harness.look(120)
    (body,), (headers,) = receiver.bodies, receiver.headers
    assert (body["level"], "Disk" in body["text"], mailbox.letters) == ("warning", True, [])
    signature = hmac.new(SECRET.encode(), headers["raw"].encode(), hashlib.sha256).hexdigest()
    assert headers["X-GSS-Signature"] == f"sha256={signature}"
    harness.look(600)
    (letter,) = mailbox.letters
    assert "not acknowledged for 10 min" in letter.replace("=\r\n", "")
    harness.alarms.acknowledge(harness.alarms.opened()[0].row.id, user="ann")
    harness.look(3600)
    assert (len(receiver.bodies), len(mailbox.letters)) == (1, 1)


@pytest.mark.parametrize("acknowledged", [False, True])
@pytest.mark.parametrize("restarted", [False, True])
def test_the_time_without_acknowledgement_starts_again_at_a_worse_level(
    harness, mailbox, receiver, acknowledged, restarted
):
    """If an acknowledged alarm becomes worse, it escalates ten minutes later, also after a restart. If it was not acknowledged
    before, it escalates ten minutes after it was raised."""
    harness.raise_alarm()
    harness.look()
    if acknowledged:
        harness.look(60)
        harness.alarms.acknowledge(harness.alarms.opened()[0].row.id, user="ann")
    harness.look(300)
    harness.raise_alarm(State.CRITICAL)
    harness.look(120)
    if restarted:
        harness.service.stop()
        harness.service = harness.new_service()
    harness.look(240)
    assert len(mailbox.letters) == (0 if acknowledged else 1)
    harness.look(300)
    assert len(mailbox.letters) == 1
    assert [body["level"] for body in receiver.bodies] == ["warning", "critical"]


def test_a_worse_level_is_sent_again(harness, receiver):
    """An alarm that becomes critical after a warning gives a second message."""
    harness.raise_alarm()
    harness.look()
    harness.raise_alarm(State.CRITICAL)
    harness.look(61)
    assert [body["level"] for body in receiver.bodies] == ["warning", "critical"]


def test_an_acknowledged_alarm_that_waits_is_withdrawn(harness, receiver):
    """A message that failed is withdrawn when its alarm is acknowledged, and is not sent again."""
    receiver.status = 500
    harness.raise_alarm()
    assert list(harness.look().values()) == ["pending"]
    harness.alarms.acknowledge(harness.alarms.opened()[0].row.id, user="ann")
    receiver.status = 200
    assert list(harness.look(600).values()) == ["withdrawn"]
    assert len(receiver.bodies) == 1


def test_an_alarm_that_is_no_longer_shelved_is_sent(harness, receiver):
    """A message that was withdrawn because its alarm was shelved is sent if the alarm still needs an answer after that,
    and only once."""
    receiver.status = 500
    harness.raise_alarm()
    harness.look()
    alarm_id = harness.alarms.opened()[0].row.id
    harness.alarms.shelve(alarm_id, harness.clock() + timedelta(minutes=5), user="ann", note="a pass")
    assert list(harness.look(60).values()) == ["withdrawn"]
    receiver.status = 200
    assert list(harness.look(300).values()) == ["sent"]
    assert (len(receiver.bodies), harness.service.newest(1)[0].tries) == (2, 1)
    harness.alarms.shelve(alarm_id, harness.clock() + timedelta(minutes=1), user="ann", note="a pass")
    assert [list(harness.look(s).values()) for s in (30, 60)] == [["sent"]] * 2
    assert len(receiver.bodies) == 2


def test_events_that_a_failing_store_rejects_are_sent_later(harness, receiver):
    """Events whose messages cannot be stored are handled by the next pass."""
    harness.bus.record("transfer", "warning", "frame 1 failed")
    with sqlite3.connect(str(harness.database.engine.url.database), isolation_level=None) as disk:
        disk.execute("CREATE TRIGGER full BEFORE INSERT ON notifications BEGIN SELECT RAISE(ABORT, 'full'); END")
        with pytest.raises(IntegrityError, match="full"):
            harness.service.tick()
        disk.execute("DROP TRIGGER full")
    disk.close()
    harness.bus.record("transfer", "warning", "frame 2 failed")
    harness.look()
    assert ["2 notifications" in body["subject"] for body in receiver.bodies] == [True]


def test_a_clock_that_is_set_back_delays_no_message(harness, receiver):
    """After the clock is set back, the pause between messages and the wait for a retry keep their lengths."""
    harness.bus.record("transfer", "warning", "frame 1 failed")
    harness.look()
    harness.set_clock_back(3 * 3600)
    receiver.status = 500
    harness.raise_alarm(State.CRITICAL)
    harness.look(30)
    assert len(receiver.bodies) == 1
    harness.look(31)
    assert len(receiver.bodies) == 2
    harness.set_clock_back(3 * 3600)
    receiver.status = 200
    harness.look()
    harness.look(LAST_RETRY.total_seconds())
    assert len(receiver.bodies) == 3
    assert [row.state for row in harness.service.newest(100)] == ["sent", "sent"]


def test_quiet_hours_have_their_end_after_the_clock_is_set_back(database, bus, clock, tmp_path, mailbox, receiver):
    """A message that waits for the end of the quiet hours is sent at this end, and at once before the quiet hours."""
    start, end = f"{clock() - timedelta(hours=1):%H:%M}", f"{clock() + timedelta(hours=2):%H:%M}"
    rules = RULES.format(mail=mailbox.port, hook=receiver.port).replace(
        "    escalate: [{after_min: 10, to: [mail]}]", f'    quiet: {{start: "{start}", end: "{end}"}}'
    )
    harness = Harness(database, bus, clock, tmp_path, rules)
    harness.raise_alarm()
    harness.look()
    harness.set_clock_back(1800)
    assert list(harness.look(2 * 3600).values()) == ["pending"]
    harness.set_clock_back(3 * 3600)
    assert list(harness.look().values()) == ["sent"]
    harness.service.stop()


def test_many_events_are_combined_to_one_message(harness, receiver):
    """Events within a minute after the first message are combined to one message."""
    for k in range(60):
        harness.bus.record("transfer", "warning", f"frame {k} failed")
        harness.bus.record("frame", "warning", "another kind")
        harness.bus.record("transfer", "watch", "less than a warning")
        if k == 0:
            harness.look()
    states = harness.look(30)
    assert len(receiver.bodies) == 1
    assert list(states.values()).count("pending") == 59
    harness.look(31)
    assert len(receiver.bodies) == 2
    assert "59 notifications" in receiver.bodies[1]["subject"]
    assert "and 19 more" in receiver.bodies[1]["text"]


def test_a_failed_message_is_retried_a_limited_number_of_times(harness, receiver):
    """A failed message is retried with the same key. After ``MAX_TRIES`` attempts an event records the failure."""
    receiver.status = 503
    harness.raise_alarm()
    for _ in range(MAX_TRIES + 2):
        states = harness.look(901)
    assert "failed" in states.values()
    hook = [h for h, b in zip(receiver.headers, receiver.bodies, strict=True) if "not acknowledged" not in b["text"]]
    assert len(hook) == MAX_TRIES
    assert len({h["Idempotency-Key"] for h in hook}) == 1
    assert any(e.kind == "notification" and "503" in e.text for e in harness.bus.after(0, 1000))


def test_a_receiver_that_hangs_delays_no_other_target(harness, mailbox, receiver):
    """The mail is sent while the webhook does not respond."""
    receiver.gate.clear()
    harness.raise_alarm()
    harness.clock.forward(601)
    harness.service.tick()
    harness.service._sending["mail"][0].result(timeout=30)
    assert len(mailbox.letters) == 1
    assert not harness.service._sending["hook"][0].done()


def test_a_mail_server_that_hangs_delays_no_other_target(harness, mailbox, receiver):
    """Webhooks are sent while the mail server does not respond. The mail is sent once when it responds again."""
    mailbox.gate.clear()
    harness.raise_alarm()
    harness.clock.forward(601)
    harness.service.tick()
    harness.service._sending["hook"][0].result(timeout=30)
    assert len(receiver.bodies) == 1
    assert not harness.service._sending["mail"][0].done()
    mailbox.gate.set()
    harness.look()
    harness.look(900)
    assert len(mailbox.letters) == 1


def test_nothing_is_sent_twice_over_a_restart(harness, receiver):
    """After a restart a sent message is not sent again. A message being sent when the server ended is unknown."""
    harness.raise_alarm()
    harness.look()
    receiver.gate.clear()
    harness.bus.record("transfer", "warning", "frame 1 failed")
    harness.clock.forward(61)
    harness.service.tick()
    first, harness.service = harness.service, harness.new_service()
    receiver.gate.set()
    first._sending["hook"][0].result(timeout=30)
    states = harness.look(61)
    assert sorted(states.values()) == ["sent", "unknown"]
    assert len(receiver.bodies) == 2
    first.stop()


def test_a_locked_database_does_not_prevent_the_start(harness):
    """The service starts while the database is locked, and writes when it is unlocked."""
    lock = sqlite3.connect(str(harness.database.engine.url.database), isolation_level=None)
    lock.execute("BEGIN IMMEDIATE")
    service = harness.new_service()
    lock.execute("ROLLBACK")
    lock.close()
    service.tick()
    service.stop()


def test_quiet_hours_delay_all_but_critical_alarms(database, bus, clock, tmp_path, mailbox, receiver):
    """A warning waits for the end of the quiet hours, a critical alarm does not."""
    start, end = f"{clock():%H:%M}", f"{clock().replace(hour=(clock().hour + 2) % 24):%H:%M}"
    rules = RULES.format(mail=mailbox.port, hook=receiver.port).replace(
        "    escalate: [{after_min: 10, to: [mail]}]", f'    quiet: {{start: "{start}", end: "{end}"}}'
    )
    harness = Harness(database, bus, clock, tmp_path, rules)
    harness.raise_alarm()
    assert list(harness.look().values()) == ["pending"]
    harness.raise_alarm(State.CRITICAL)
    harness.look(61)
    assert [body["level"] for body in receiver.bodies] == ["critical"]
    harness.look(7200)
    assert len(receiver.bodies) == 2
    harness.service.stop()


def test_a_rejected_recipient_is_recorded(database, bus, clock, tmp_path, mailbox, receiver):
    """If the server rejects a recipient, the others get the mail once, and an event names the rejected one."""
    rules = RULES.format(mail=mailbox.port, hook=receiver.port).replace(
        "[op@example.org]", "[op@example.org, gone@example.org]"
    )
    harness = Harness(database, bus, clock, tmp_path, rules)
    harness.service.test("mail", user="ann")
    assert list(harness.look().values()) == ["sent"]
    harness.look(900)
    assert len(mailbox.letters) == 1
    assert "gone@example.org" in harness.service.newest(1)[0].problem
    assert any(e.kind == "notification" and "gone@example.org" in e.text for e in bus.after(0, 100))
    harness.service.stop()


@pytest.mark.parametrize(
    "address", ["127.0.0.1", "10.1.2.3", "169.254.1.1", "224.0.0.1", "::1", "::ffff:10.0.0.1", "64:ff9b::7f00:1"]
)
def test_addresses_that_are_not_public(address):
    """Loopback, private, link-local and multicast addresses are not public, also if they are embedded in IPv6."""
    assert not is_public(address)
    assert is_public("2606:4700::1111")


def test_a_private_address_needs_the_setting(harness):
    """A loopback address is rejected by default, and the message names the setting."""
    target = harness.service.rules.target("hook")
    with pytest.raises(NotPermitted, match="GSS_NOTIFICATIONS_PRIVATE"):
        Sender(False, ENVIRONMENT).send(target, OutgoingMessage("k", "ok", "s", "t"))


def test_a_test_message_is_sent(harness, mailbox):
    """A test message is sent to one target. An unknown target is rejected."""
    harness.service.test("mail", user="ann")
    harness.look()
    assert "Test message by ann" in mailbox.letters[0]
    with pytest.raises(NotFound):
        harness.service.test("pager", user="ann")


QUIET = "    escalate: [{after_min: 10, to: [mail]}]", "    quiet: {start: START, end: 06:00}"


@pytest.mark.parametrize(("start", "words"), [("22:00", "22:00"), ('"22:00"', "22:00"), ("08:30:15", "08:30")])
def test_quiet_hours_are_read_with_and_without_quotation_marks(tmp_path, start, words):
    """The quiet hours are those of the file."""
    file = tmp_path / "rules.yaml"
    file.write_text(RULES.format(mail=25, hook=80).replace(*QUIET).replace("START", start))
    assert f"waits from {words} to 06:00 UTC" in read_rules(str(file), ENVIRONMENT).rules[0].words


@pytest.mark.parametrize("start", ["1320", "22.5", '"22:00Z"', '"22:00+02:00"', "24:00", "9:30", "22:00:00.5", "true"])
def test_other_forms_of_quiet_hours_are_rejected(tmp_path, start):
    """Numbers and times with a time zone are rejected with line, field and form."""
    file = tmp_path / "rules.yaml"
    file.write_text(RULES.format(mail=25, hook=80).replace(*QUIET).replace("START", start))
    with pytest.raises(BadInput, match=r"line 12: rules\.0\.quiet\.start: must be a time in UTC as HH:MM"):
        read_rules(str(file), ENVIRONMENT)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (("level: warning", "level: bad"), "line 10: rules.0.level"),
        (("to: [hook]\n    escalate", "to: [pager]\n    escalate"), "no such target: pager"),
        (("secret_env: HOOK", "secret_env: NONE"), "line 6: targets.1: the environment variable NONE is not set"),
        (("on: event\n    kinds: [transfer]", "on: event"), "needs kinds"),
        (("kinds: [transfer]", "kinds: [notification]"), "not sent"),
        (("sender: gss@example.org", "sender: me"), "sender"),
        (("name: hook", "name: mail"), "same name"),
        (("security: none,", "security: none, user: gss,"), "encrypted"),
        (("pause_s: 60", "pause: 60"), "line 2: pause"),
    ],
)
def test_an_invalid_file_is_rejected_with_its_line(tmp_path, change, words):
    """An invalid file is rejected with line, field and reason."""
    file = tmp_path / "rules.yaml"
    file.write_text(RULES.format(mail=25, hook=80).replace(*change, 1))
    with pytest.raises(BadInput, match=words):
        read_rules(str(file), ENVIRONMENT)
