"""Monitor of the heads of all spacecraft. It receives attitudes, compares them, stores the results and raises alarms."""

from __future__ import annotations

import logging
import queue
import threading
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta

import numpy as np

from gss.domain.angles import Array
from gss.domain.errors import Conflict
from gss.domain.limits import State
from gss.operations.clock import Now
from gss.operations.heads.judge import AgreementWatch, HeadsVerdict, findings, verdict
from gss.operations.heads.mountings import SpacecraftSetup
from gss.operations.heads.spacecraft_book import SpacecraftBook
from gss.operations.heads.tracker import HeadsResult, HeadTracker, PairResult
from gss.operations.telemetry.alarm_text import HEADS
from gss.operations.telemetry.alarms import AlarmService
from gss.operations.telemetry.last_attitude import AttitudeSample
from gss.pipeline.heads.misalignment import Misalignment
from gss.store import heads as store
from gss.store.engine import Database
from gss.store.models import FusedRow, HeadPairRow

log = logging.getLogger("gss.heads")
TICK_S = 0.5
RELOAD_S = 5.0
"""Interval at which the stored spacecraft are read again, because other processes can change them."""
STORED_EVERY_S = 10.0
KEPT = timedelta(days=30)
CLEANED_EVERY_S = 3600.0
UPPER = np.triu_indices(6)
UPPER_3 = np.triu_indices(3)


@dataclass(frozen=True)
class HeadState:
    """Current state of one head. ``problem``: reason why its attitude is not used, "" if it is used. ``age_s``: age of its
    latest attitude, None if no attitude was received."""

    unit: str
    fresh: bool
    age_s: float | None
    problem: str


@dataclass(frozen=True)
class SpacecraftState:
    """Current state of one spacecraft. ``result``: the latest comparison, None before the first."""

    setup: SpacecraftSetup
    verdict: HeadsVerdict
    heads: tuple[HeadState, ...]
    result: HeadsResult | None


class _Follower:
    """One monitored spacecraft. ``stored_s``: time of the latest stored comparison."""

    def __init__(self, tracker: HeadTracker) -> None:
        self.tracker, self.agreement, self.stored_s = tracker, AgreementWatch(), 0.0


class HeadWatch:
    """Compares heads in a separate thread, so that a slow store does not delay a link. ``take`` and ``states`` can be called
    from any thread."""

    def __init__(self, book: SpacecraftBook, database: Database, alarms: AlarmService, now: Now) -> None:
        self._book, self._database, self._alarms, self._now = book, database, alarms, now
        self._arrived: queue.SimpleQueue[tuple[str, AttitudeSample]] = queue.SimpleQueue()
        self._followers: dict[int, _Follower] = {}
        self._loaded_s = self._cleaned_s = 0.0
        self._lock = threading.Lock()
        self._changed, self._stop = threading.Event(), threading.Event()
        self._thread = threading.Thread(target=self._run, name="heads", daemon=True)
        self.problem = ""
        """Reason why the last step failed, "" if it did not fail."""

    def start(self) -> None:
        """Start comparing."""
        self._thread.start()

    def stop(self) -> None:
        """Stop comparing."""
        self._stop.set()
        if self._thread.is_alive():
            self._thread.join(timeout=3)

    def take(self, unit: str, samples: Sequence[AttitudeSample]) -> None:
        """Queue the latest attitudes of a unit. Attitudes that were already received are ignored."""
        for sample in samples:
            self._arrived.put((unit, sample))

    def states(self) -> list[SpacecraftState]:
        """Return the states of all spacecraft, sorted by name."""
        now_s = self._now().timestamp()
        with self._lock:
            followers = list(self._followers.values())
            return [
                _state(follower, now_s)
                for follower in sorted(followers, key=lambda follower: follower.tracker.setup.name)
            ]

    def correct(self, spacecraft_id: int, unit: str, *, user: str) -> SpacecraftSetup:
        """Correct the mounting of a head by its estimated misalignment. Raises Conflict if there is no current estimate."""
        with self._lock:
            follower = self._followers.get(spacecraft_id)
            result = follower.tracker.result if follower else None
        pairs = result.pairs if result else ()
        pair = next((pair_state for pair_state in pairs if pair_state.unit == unit), None)
        if pair is None:
            raise Conflict(
                "there is no current misalignment estimate of this head",
                expected="a head that is compared with the reference head now",
                got=unit,
            )
        setup = self._book.correct(spacecraft_id, pair, user=user)
        self.refresh()
        return setup

    def refresh(self) -> None:
        """Read the stored spacecraft again at the next step."""
        self._changed.set()

    def step(self) -> None:
        """Process the received attitudes: compare the heads, store the results, and update the alarms. Called by the thread."""
        now = self._now()
        now_s = now.timestamp()
        if self._changed.is_set() or abs(now_s - self._loaded_s) >= RELOAD_S:
            self._changed.clear()
            self._loaded_s = now_s
            self._reload()
        arrived = []
        while not self._arrived.empty():
            arrived.append(self._arrived.get())
        compared: list[tuple[_Follower, list[HeadsResult]]] = []
        with self._lock:
            for follower in self._followers.values():
                for unit, sample in arrived:
                    follower.tracker.add(unit, sample, now_s)
                results = follower.tracker.advance(now_s)
                for result in results:
                    agreement = result.fused.agreement
                    follower.agreement.take(agreement.probability if agreement else None)
                compared.append((follower, results))
        for follower, results in compared:
            self._keep(follower, results)
        if abs(now_s - self._cleaned_s) >= CLEANED_EVERY_S:
            self._cleaned_s = now_s
            with self._database.unit_of_work() as session:
                store.delete_before(session, now - KEPT)

    def _reload(self) -> None:
        """Read the stored spacecraft. For a changed spacecraft, tracking restarts and its alarms are cleared until the next
        comparison."""
        before, after = self._followers, {}
        for setup in self._book.list_all():
            if setup.problem:
                continue
            previous = before.get(setup.id)
            same = previous is not None and previous.tracker.setup.changed == setup.changed
            after[setup.id] = previous if previous and same else _Follower(HeadTracker(setup, self._resumed(setup)))
        with self._lock:
            self._followers = after
        for spacecraft_id, follower in before.items():
            if after.get(spacecraft_id) is not follower:
                self._clear_alarms(f"{follower.tracker.setup.name}: ")

    def _clear_alarms(self, prefix: str) -> None:
        for key in self._alarms.open_keys():
            if key[0] == HEADS and key[1].startswith(prefix):
                self._alarms.watch(key, State.OK, 0.0, "", "")

    def _run(self) -> None:
        while not self._stop.wait(TICK_S):
            try:
                self.step()
                self.problem = ""
            except Exception as error:  # a locked database or a damaged row must not end the watch
                self.problem = str(error) or type(error).__name__
                log.exception("the heads could not be compared")

    def _keep(self, follower: _Follower, results: Sequence[HeadsResult]) -> None:
        setup = follower.tracker.setup
        rows: list[FusedRow | HeadPairRow] = []
        for result in results:
            if abs(result.time_s - follower.stored_s) >= STORED_EVERY_S:
                follower.stored_s = result.time_s
                rows += [_fused_row(setup.id, result), *(_pair_row(setup.id, result.time_s, p) for p in result.pairs)]
        if rows:
            with self._database.unit_of_work() as session:
                if store.exists(session, setup.id):
                    store.add_results(session, rows)
        if results and results[-1].fused.agreement is not None:
            last, chi2 = results[-1], results[-1].fused.agreement.chi2
            for finding in findings(setup, follower.agreement.disagreeing, last.pairs, chi2):
                self._alarms.watch((HEADS, finding.name), finding.state, finding.value, finding.text, finding.limit)

    def _resumed(self, setup: SpacecraftSetup) -> dict[str, Misalignment]:
        """Return the latest stored estimate of each head since the last change of the spacecraft."""
        with self._database.unit_of_work() as session:
            rows = {h.unit: store.newest_pair(session, setup.id, h.unit, setup.changed) for h in setup.heads[1:]}
        return {unit: estimate_of(row) for unit, row in rows.items() if row is not None}


def estimate_of(row: HeadPairRow) -> Misalignment:
    """Return the misalignment estimate of a stored row."""
    covariance = np.zeros((6, 6))
    covariance[UPPER] = row.covariance
    covariance = covariance + np.triu(covariance, 1).T
    began_s = row.began.timestamp()
    return Misalignment(row.at.timestamp(), np.array(row.state), covariance, began_s, row.samples, 0, row.restarts)


def _state(follower: _Follower, now_s: float) -> SpacecraftState:
    tracker = follower.tracker
    heads = tuple(
        HeadState(h.unit, tracker.is_fresh(h.unit, now_s), tracker.age_s(h.unit, now_s), tracker.problem(h.unit))
        for h in tracker.setup.heads
    )
    return SpacecraftState(
        tracker.setup, verdict(tracker, follower.agreement.disagreeing, now_s), heads, tracker.result
    )


def _fused_row(spacecraft_id: int, result: HeadsResult) -> FusedRow:
    fused, agreement = result.fused, result.fused.agreement
    return FusedRow(
        spacecraft_id=spacecraft_id,
        at=datetime.fromtimestamp(result.time_s, UTC),
        units=list(result.attitudes),
        quaternion=_listed(fused.quaternion),
        covariance=_listed(fused.covariance_rad2[UPPER_3]),
        chi2=None if agreement is None else agreement.chi2,
        freedom=None if agreement is None else agreement.freedom,
        probability=None if agreement is None else agreement.probability,
    )


def _pair_row(spacecraft_id: int, time_s: float, pair: PairResult) -> HeadPairRow:
    difference, misalignment = pair.difference, pair.misalignment
    return HeadPairRow(
        spacecraft_id=spacecraft_id,
        at=datetime.fromtimestamp(time_s, UTC),
        reference=pair.reference,
        unit=pair.unit,
        angle_rad=difference.angle_rad,
        angle_sigma_rad=difference.angle_sigma_rad,
        boresight_rad=difference.boresight_rad,
        boresight_sigma_rad=difference.boresight_sigma_rad,
        chi2=difference.agreement.chi2,
        state=_listed(misalignment.state),
        covariance=_listed(misalignment.covariance[UPPER]),
        lasting=_listed(np.diag(pair.lasting_rad2)),
        began=datetime.fromtimestamp(misalignment.began_s, UTC),
        samples=misalignment.samples,
        restarts=misalignment.restarts,
    )


def _listed(values: Array) -> list[float]:
    return [float(v) for v in values]
