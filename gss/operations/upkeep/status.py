"""Publishes the overall state to all browsers once a second, for the header bar."""

from __future__ import annotations

import logging
import threading
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import datetime

from gss.domain.errors import Conflict
from gss.instruments.operations import Operation, absence
from gss.operations.clock import Now, iso_z
from gss.operations.commanding.authority import AuthorityService
from gss.operations.events import EventBus
from gss.operations.frames.ground_attitude import GroundAttitude
from gss.operations.line.link import LinkService
from gss.operations.telemetry.alarm_text import SIGNAL
from gss.operations.telemetry.alarms import AlarmService
from gss.operations.telemetry.last_attitude import AttitudeSample, LastAttitude, ReportedAttitude
from gss.operations.transfers.banks import BankService, BankView
from gss.orbit.passes import NextPass

log = logging.getLogger("gss.status")

TICK_S = 1.0
UP_WITHIN_S = 3.0
NOISY_ABOVE = 0.005
ERROR_WINDOW_S = 60
Conditions = dict[str, tuple[str, str]]
ORDER = {"ok": 0, "unknown": 1, "watch": 2, "warning": 3, "critical": 4}


class Restarted(Conflict):
    """The server has started again since the caller read its state. ``got``: time of the present start, ISO 8601."""


@dataclass(frozen=True)
class DirectionState:
    """State of one direction of the line. ``state``: up, noisy or down; ``error_rate``: share of damaged packets in the
    last minute."""

    state: str
    age_s: float | None
    error_rate: float
    bytes: int
    frames: int
    bad: int


@dataclass(frozen=True)
class StatusAlarm:
    """A condition that needs attention. ``since``: its start."""

    id: str
    level: str
    text: str
    since: datetime


@dataclass(frozen=True)
class Header:
    """Content of the header bar."""

    device: str
    profile: str
    firmware: str
    simulated: bool | None
    """None if it is not known."""
    tried_on_hardware: bool | None
    no_abort: str
    url: str
    connected: bool
    reason: str
    tx: DirectionState
    rx: DirectionState
    mode: str | None
    cycle_running: bool | None
    """None if it is not reported."""
    attitude: ReportedAttitude | None
    attitudes: list[AttitudeSample]
    next_pass: NextPass
    banks: list[BankView]
    dictionary_hash: str
    device_dictionary_hash: str | None
    dictionary_match: bool | None
    dictionary_acknowledged: bool
    alarms: list[StatusAlarm]
    contact_id: int | None
    authority: str | None
    server_started: datetime
    utc: datetime


class StatusService:
    """Publishes the header once a second, after it has called each function in ``tickers``."""

    def __init__(
        self,
        link: LinkService,
        banks: BankService,
        alarms: AlarmService,
        bus: EventBus,
        now: Now,
        authority: AuthorityService,
        attitude: LastAttitude,
        ground: GroundAttitude,
        next_pass: Callable[[], NextPass],
        tried_on_hardware: bool | None,
        tickers: Sequence[Callable[[], None]],
    ) -> None:
        self._link, self._banks, self._latched = link, banks, alarms
        self._bus, self._now, self._authority = bus, now, authority
        self._attitude, self._ground, self._next_pass = attitude, ground, next_pass
        self._tried_on_hardware = tried_on_hardware
        self._started = now()
        self._since: dict[str, datetime] = {}
        self._counts: deque[tuple[float, int, int]] = deque()
        self._last_sent: tuple[int, float] = (0, 0.0)
        self._last_bytes: tuple[int, float] = (0, -UP_WITHIN_S)
        self._lock = threading.Lock()  # requests and the status thread call header() concurrently
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="status", daemon=True)
        self._tickers = tuple(tickers)

    def start(self) -> None:
        """Start publishing."""
        self._thread.start()

    def stop(self) -> None:
        """Stop publishing."""
        self._stop.set()
        if self._thread.is_alive():
            self._thread.join(timeout=3)

    def _run(self) -> None:
        while not self._stop.wait(TICK_S):
            for tick in (*self._tickers, self._publish):
                try:
                    tick()
                except Exception:  # a full disk or a locked database must not end the status thread
                    log.exception("%r failed", tick)

    def _publish(self) -> None:
        self._bus.publish("link", self.header())

    def header(self) -> Header:
        """Return the current content of the header bar."""
        hello, status = self._link.last_hello, self._link.status()
        device_hash = self._link.session.device_dictionary_hash
        match = None if device_hash is None else self._link.dictionary.describes(bytes.fromhex(device_hash))
        banks = self._banks.views()
        with self._lock:
            tx, rx = self._directions()
            alarms = self._alarms(rx, match)
        connected = self._link.connected
        mode = str(status["mode"]) if "mode" in status else self._attitude.mode()
        return Header(
            device=(hello.serial or hello.device_model) if hello else "no device",
            profile=hello.profile if hello else "",
            firmware=hello.firmware if hello else "",
            simulated=hello.simulated if hello else None,
            tried_on_hardware=self._tried_on_hardware,
            no_abort="" if self._link.roles.operations.has(Operation.ABORT) else absence(Operation.ABORT),
            url=self._link.url,
            connected=connected,
            reason=self._link.reason,
            tx=tx,
            rx=rx,
            mode=mode if connected else None,
            cycle_running=bool(status["cycle_running"]) if connected and "cycle_running" in status else None,
            attitude=self._attitude.report(),
            attitudes=[sample for sample in (self._attitude.sample(), self._ground.sample()) if sample is not None],
            next_pass=self._next_pass(),
            banks=banks,
            dictionary_hash=self._link.dictionary.hash_hex,
            device_dictionary_hash=device_hash,
            dictionary_match=match,
            dictionary_acknowledged=self._link.dictionary_acknowledged,
            alarms=alarms,
            contact_id=self._link.contact_id,
            authority=self._authority.holder(),
            server_started=self._started,
            utc=self._now(),
        )

    def require_start(self, known: datetime | None) -> None:
        """Raise Restarted if the server has started again since the start that a caller knows. None: not checked."""
        if known is not None and iso_z(known) != iso_z(self._started):
            raise Restarted(
                "The server has started again since this page was loaded",
                expected=f"start {iso_z(known)}",
                got=iso_z(self._started),
                hint="Check the state of the sensor, then send the command again if it is still necessary.",
            )

    def _directions(self) -> tuple[DirectionState, DirectionState]:
        counters, now_s = self._link.counters, self._link.monotonic_s()
        received, sent = counters.received, counters.sent
        self._counts.append((now_s, received.good, received.bad))
        while self._counts[0][0] < now_s - ERROR_WINDOW_S:
            self._counts.popleft()
        good_count, bad_count = received.good - self._counts[0][1], received.bad - self._counts[0][2]
        rate = bad_count / (good_count + bad_count) if good_count + bad_count else 0.0
        age_s = None if counters.last_good_s is None else max(0.0, now_s - counters.last_good_s)
        alive = self._link.connected and age_s is not None and age_s < UP_WITHIN_S
        rx_state = "down" if not alive else "noisy" if rate > NOISY_ABOVE else "up"
        if sent.good != self._last_sent[0]:
            self._last_sent = (sent.good, now_s)
        if received.bytes != self._last_bytes[0]:
            self._last_bytes = (received.bytes, now_s)
        tx_age_s = now_s - self._last_sent[1] if sent.good else None
        tx = DirectionState("up" if alive else "down", tx_age_s, 0.0, sent.bytes, sent.good, 0)
        return tx, DirectionState(rx_state, age_s, rate, received.bytes, received.good, received.bad)

    def _alarms(self, rx: DirectionState, match: bool | None) -> list[StatusAlarm]:
        conditions = self._line_alarms(rx, match)
        if self._link.connected:
            conditions |= self._bank_alarms()
        now = self._now()
        self._since = {key: self._since.get(key, now) for key in conditions}
        alarms = [StatusAlarm(key, level, text, self._since[key]) for key, (level, text) in conditions.items()]
        alarms += self._latched_alarms("silent" in conditions)
        return sorted(alarms, key=lambda a: (-ORDER[a.level], a.since))

    def _line_alarms(self, rx: DirectionState, match: bool | None) -> Conditions:
        conditions: Conditions = {}
        if self._link.stall:
            conditions["stall"] = ("critical", self._link.stall)
        if not self._link.connected:
            conditions["line"] = ("warning", f"Line down: {self._link.reason}")
        elif rx.state == "down":
            conditions["silent"] = ("warning", self._silence())
        elif rx.state == "noisy":
            conditions["noise"] = ("watch", f"RX frame errors {100 * rx.error_rate:.1f} %")
        if match is False:
            conditions["dictionary"] = ("warning", "Dictionary differs from the device's")
        return conditions

    def _silence(self) -> str:
        """Return what is received while no packet is valid."""
        if self._link.monotonic_s() - self._last_bytes[1] > UP_WITHIN_S:
            return f"Nothing received for {UP_WITHIN_S:g} s"
        return f"Bytes arrive, but no valid packet for {UP_WITHIN_S:g} s: check the line rate and the instrument"

    def _latched_alarms(self, silent: bool) -> list[StatusAlarm]:
        """Return the open alarms that are not shelved. If ``silent``, omit the loss of signal, which is already
        reported."""
        views = [v for v in self._latched.opened() if not v.shelved]
        return [
            StatusAlarm(f"alarm-{v.row.id}", v.row.worst, v.text, v.row.raised)
            for v in views
            if not (silent and (v.row.packet, v.row.field) == SIGNAL)
        ]

    def _bank_alarms(self) -> Conditions:
        conditions: Conditions = {}
        left_s = self._link.status().get("confirm_left_s", 0)
        if isinstance(left_s, int | float) and left_s > 0:
            conditions["confirm"] = ("warning", f"New bank unconfirmed, reverts in {left_s:.0f} s")
        return conditions
