"""Health of the installation: checks of conditions that can degrade slowly, and the same values as Prometheus
metrics."""

from __future__ import annotations

import os
import resource
import sys
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from gss import __version__
from gss.domain.errors import GssError
from gss.domain.limits import ORDER, State, worst
from gss.operations.clock import Monotonic, Now
from gss.operations.frames.frames import FrameService
from gss.operations.frames.loop_compiler import LoopCompiler
from gss.operations.jobs import JobService
from gss.operations.line.capture_files import capture_sizes
from gss.operations.line.dispatcher import Dispatcher
from gss.operations.line.link import LinkService
from gss.operations.metrics import MetricSample, StreamCounts
from gss.operations.telemetry.telemetry import TelemetryService
from gss.operations.upkeep.audit_watch import AuditWatch
from gss.operations.upkeep.backup import BackupService
from gss.operations.upkeep.clocks import ClockWatch
from gss.operations.upkeep.disk import DiskGuard, megabytes
from gss.operations.upkeep.page_check import PageCheck
from gss.store import upkeep as store
from gss.store.blobs import BlobStore
from gss.store.engine import Database

OLD_BACKUP_DAYS = 7.0
RECEIVED_WITHIN_S = 5.0
UNKNOWN = "unknown"
PAGE_BYTES = os.sysconf("SC_PAGE_SIZE")
KIB = 1 if sys.platform == "darwin" else 1024


@dataclass(frozen=True)
class HealthCheck:
    """Result of one check. ``state``: ok, watch, warning, critical or unknown."""

    name: str
    state: str
    value: float | None
    text: str


@dataclass(frozen=True)
class Health:
    """Results of all checks, and the worst state."""

    state: str
    checks: tuple[HealthCheck, ...]


class HealthService:
    """Runs the health checks on request."""

    def __init__(
        self,
        database: Database,
        disk: DiskGuard,
        blobs: BlobStore,
        captures: Path,
        link: LinkService,
        telemetry: TelemetryService,
        frames: FrameService,
        compiler: LoopCompiler,
        jobs: JobService,
        backups: BackupService,
        clocks: ClockWatch,
        pages: PageCheck,
        audit: AuditWatch,
        dispatcher: Dispatcher,
        streams: StreamCounts,
        now: Now,
        monotonic_s: Monotonic,
    ) -> None:
        self._database, self._disk, self._captures, self._link = database, disk, captures, link
        self._blobs = blobs
        self._telemetry, self._frames, self._jobs = telemetry, frames, jobs
        self._compiler = compiler
        self._backups, self._clocks, self._now, self._monotonic_s = backups, clocks, now, monotonic_s
        self._started_s = monotonic_s()
        self._audit = audit
        self._pages, self._dispatcher, self._streams = pages, dispatcher, streams

    def look(self) -> Health:
        """Run all checks now. A check that raises an exception has the state critical."""
        check_functions = (
            self._database_check,
            self._disk_check,
            self._blobs_check,
            self._captures_check,
            self._record_check,
            self._link_check,
            self._jobs_check,
            self._queues_check,
            self._solver_check,
            self._audit_log_check,
            self._clock_check,
            self._backup_check,
            self._memory_check,
            self._uptime_check,
        )
        checks = tuple(_guarded(look) for look in check_functions)
        states = [State(c.state) for c in checks if c.state != UNKNOWN]
        return Health(max(states, key=ORDER.__getitem__, default=State.OK).value, checks)

    def _database_check(self) -> HealthCheck:
        if self._database.damage:
            text = f"damaged: {self._database.damage}; run gss check store, then gss restore"
            return HealthCheck("database", "critical", None, text)
        with self._database.unit_of_work() as session:
            size = store.database_bytes(session)
        pages = f"; {self._pages.state}" if self._pages.state else ""
        return HealthCheck("database", "ok", size, megabytes(size) + pages)

    def _audit_log_check(self) -> HealthCheck:
        if self._audit.problem:
            return HealthCheck("audit log", "critical", None, f"not intact: {self._audit.problem}")
        return HealthCheck("audit log", "ok", None, self._audit.state)

    def _disk_check(self) -> HealthCheck:
        room = self._disk.look()
        return HealthCheck("disk", room.level.value, room.free_bytes, room.text)

    def _blobs_check(self) -> HealthCheck:
        return HealthCheck("blobs", "ok", None, self._blobs.check())

    def _captures_check(self) -> HealthCheck:
        size = sum(file.bytes for file in capture_sizes(self._captures))
        lost = self._link.capture.lost_bytes
        if self._link.capture.fails:
            return HealthCheck(
                "captures", "critical", lost, f"not written: {self._link.capture.fails}; {lost} bytes lost"
            )
        text = f"{megabytes(size)}" + (f"; {lost} bytes were lost earlier" if lost else "")
        return HealthCheck("captures", "watch" if lost else "ok", size, text)

    def _record_check(self) -> HealthCheck:
        fails, unstored = self._telemetry.store_fails, self._telemetry.unstored
        if fails:
            return HealthCheck(
                "telemetry record",
                "critical",
                unstored,
                f"not stored: {fails}; {unstored} packets since the server started",
            )
        text = f"{unstored} packets are in the raw capture only" if unstored else "every packet was stored"
        return HealthCheck("telemetry record", "watch" if unstored else "ok", unstored, text)

    def _link_check(self) -> HealthCheck:
        if not self._link.connected:
            return HealthCheck("link", "watch" if self._link.url else "ok", None, f"down: {self._link.reason}")
        last_good_s = self._link.counters.last_good_s
        age_s = None if last_good_s is None else max(0.0, self._monotonic_s() - last_good_s)
        if not self._link.alive():
            return HealthCheck("link", "critical", age_s, "the link thread does not respond")
        if self._dispatcher.is_slow():
            text = f"received data has been waiting for the store for {self._dispatcher.busy_s:.0f} s"
            return HealthCheck("link", "critical", age_s, text)
        if age_s is None or age_s > RECEIVED_WITHIN_S:
            return HealthCheck("link", "warning", age_s, "open, but no valid packet received")
        return HealthCheck("link", "ok", age_s, f"up on {self._link.url}")

    def _jobs_check(self) -> HealthCheck:
        waiting = self._jobs.waiting()
        failed = [job for job in self._jobs.newest(20) if job.state == "failed"]
        text = f"{waiting} queued or running" + (f", {len(failed)} of the last 20 failed" if failed else "")
        return HealthCheck("jobs", "watch" if failed else "ok", waiting, text)

    def _queues_check(self) -> HealthCheck:
        lost = self._dropped()
        total = sum(lost.values())
        losses = ", ".join(f"{name} {number}" for name, number in lost.items() if number)
        return HealthCheck(
            "queues", "watch" if total else "ok", total, f"dropped: {losses}" if total else "nothing dropped"
        )

    def _solver_check(self) -> HealthCheck:
        state = self._compiler.state
        return HealthCheck("solver loops", "watch" if state.startswith("not compiled") else "ok", None, state)

    def _dropped(self) -> dict[str, int]:
        """Return the number of items that each bounded queue has dropped, by queue name."""
        frames, events, messages = self._frames.queue.skipped, self._dispatcher.dropped, self._streams.dropped
        return {"solve": frames, "line events": events, "stream": messages}

    def _clock_check(self) -> HealthCheck:
        jump_s = self._clocks.last_jump_s
        if jump_s is None:
            return HealthCheck("clock", "ok", None, "no jump since the server started")
        state = "watch" if self._clocks.steady() else "warning"
        return HealthCheck("clock", state, jump_s, f"jumped by {jump_s:+.1f} s")

    def _backup_check(self) -> HealthCheck:
        at, room = self._backups.newest_at(), self._backups.disk.look()
        if at is None:
            days, text = None, "There is no backup. Run gss backup, or use Admin, Backup."
        else:
            days = (self._now() - at).total_seconds() / 86400
            text = f"{days:.1f} days old"
        age = State.WATCH if days is None or days > OLD_BACKUP_DAYS else State.OK
        if room.level is not State.OK:
            text += f"; {self._backups.disk.name}: {room.text}"
        return HealthCheck("backup", worst((age, room.level)).value, days, text)

    def _memory_check(self) -> HealthCheck:
        current_bytes, peak_bytes = memory_bytes()
        return HealthCheck(
            "memory", "ok", current_bytes, f"{megabytes(current_bytes)}, at most {megabytes(peak_bytes)}"
        )

    def _uptime_check(self) -> HealthCheck:
        up_s = self._monotonic_s() - self._started_s
        return HealthCheck("version", "ok", up_s, f"GSS {__version__}, up for {up_s / 3600:.1f} h")

    # --- metrics ------------------------------------------------------------------------------------------------

    def samples(self) -> Iterator[MetricSample]:
        """Yield the current metrics."""
        counters = self._link.counters
        for label, counter in (("sent", counters.sent), ("received", counters.received)):
            yield _counter("gss_link_bytes_total", "Bytes on the line.", counter.bytes, direction=label)
            yield _counter("gss_link_packets_total", "Good packets on the line.", counter.good, direction=label)
        received = counters.received
        for cause in ("bad_crc", "too_long", "too_short", "unframed", "unknown", "undecodable"):
            help_text = "Packets or bytes that could not be used."
            yield _counter("gss_link_errors_total", help_text, getattr(received, cause), cause=cause)
        yield _counter("gss_link_gaps_total", "Packets missing by their sequence counts.", received.gaps)
        yield _counter("gss_link_duplicates_total", "Duplicate packets.", received.duplicates)
        yield _gauge("gss_link_up", "1 if the line is open.", float(self._link.connected))
        yield _counter(
            "gss_capture_lost_bytes_total",
            "Bytes of the line missing from the raw capture.",
            self._link.capture.lost_bytes,
        )
        yield _counter(
            "gss_telemetry_unstored_total", "Packets missing from the telemetry archive.", self._telemetry.unstored
        )
        yield _counter("gss_telemetry_old_total", "Packets older than the latest of their type.", self._telemetry.old)
        for name, count in self._dropped().items():
            yield _counter("gss_queue_dropped_total", "Messages dropped by a full queue.", count, queue=name)
        yield _gauge("gss_queue_depth", "Items waiting in a queue.", len(self._frames.queue), queue="solve")
        yield _gauge("gss_queue_depth", "Items waiting in a queue.", self._jobs.waiting(), queue="jobs")
        yield _gauge("gss_stream_clients", "Open event streams.", self._streams.clients)
        yield _counter("gss_streams_refused_total", "Event streams over the limit.", self._streams.refused)
        disk = self._disk.look()
        yield _gauge("gss_disk_free_bytes", "Free space on the disk of the data folder.", disk.free_bytes)
        with self._database.unit_of_work() as session:
            yield _gauge("gss_database_bytes", "Bytes that the database uses.", store.database_bytes(session))
            for name, state, number in store.states(session):
                yield _gauge(f"gss_{name}", f"Stored {name} by state.", number, state=state)
            yield _gauge("gss_frames", "Stored frames.", store.frame_count(session))
        current_bytes, peak_bytes = memory_bytes()
        yield _gauge("process_resident_memory_bytes", "Memory in use.", current_bytes)
        yield _gauge("gss_process_most_memory_bytes", "Peak memory in use.", peak_bytes)
        usage = resource.getrusage(resource.RUSAGE_SELF)
        yield _counter("process_cpu_seconds_total", "Processor time.", usage.ru_utime + usage.ru_stime)
        yield _gauge("process_threads", "Threads.", threading.active_count())
        yield _gauge("gss_uptime_seconds", "Time since the server started.", self._monotonic_s() - self._started_s)
        yield _gauge("gss_info", "Running version.", 1, version=__version__)


def memory_bytes() -> tuple[int, int]:
    """Return the current and the peak resident memory of this process in bytes."""
    peak_bytes = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * KIB
    try:
        pages = int(Path("/proc/self/statm").read_text().split()[1])
    except OSError:
        return peak_bytes, peak_bytes
    return pages * PAGE_BYTES, peak_bytes


def _guarded(check: Callable[[], HealthCheck]) -> HealthCheck:
    try:
        return check()
    except (GssError, OSError) as error:
        name = getattr(check, "__name__", "check").strip("_").removesuffix("_check").replace("_", " ")
        return HealthCheck(name, "critical", None, str(error))


def _gauge(name: str, text: str, value: float, **labels: str) -> MetricSample:
    return MetricSample(name, text, "gauge", value, tuple(sorted(labels.items())))


def _counter(name: str, text: str, value: float, **labels: str) -> MetricSample:
    return MetricSample(name, text, "counter", value, tuple(sorted(labels.items())))
