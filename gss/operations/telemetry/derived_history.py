"""Recomputes the history of a derived parameter from stored telemetry, as a job that can continue after an
interruption."""

from __future__ import annotations

import heapq
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from datetime import datetime, timedelta
from typing import Any

from gss.domain.errors import BadInput
from gss.instruments.dictionary.definitions import Value, Values
from gss.operations.clock import Now
from gss.operations.jobs import JobKind, JobRequest, JobResult, JobRun, JobService
from gss.operations.telemetry.derived import ComputedParameter, DerivedParameters
from gss.operations.telemetry.value_format import plain_values
from gss.store import derived as store
from gss.store import telemetry as packets
from gss.store.engine import Database
from gss.store.models import Job

STEP = timedelta(hours=1)
"""Time span that is replaced in one transaction."""
MAX_SPAN = timedelta(days=3660)


@dataclass(frozen=True)
class DeriveJob(JobRequest):
    """Recomputation of the parameter ``name`` from ``start`` to ``end``, excluding the end."""

    name: str
    start: datetime
    end: datetime


@dataclass(frozen=True)
class Recomputed:
    """Checkpoint of a job. ``at``: time reached; ``values``, ``unknown``: numbers of known and unknown values."""

    at: str
    values: int = 0
    unknown: int = 0


@dataclass(frozen=True)
class _TimeStep:
    """Time span that is replaced in one transaction."""

    start: datetime
    end: datetime


class DerivedHistory:
    """Recomputes the history of derived parameters."""

    def __init__(self, derived: DerivedParameters, database: Database, jobs: JobService, now: Now) -> None:
        self._derived, self._database, self._jobs, self._now = derived, database, jobs, now
        jobs.register(JobKind("derive", DeriveJob, self._work))

    def recompute(self, name: str, start: datetime, end: datetime, *, user: str) -> Job:
        """Start a job that replaces the stored values of a time span. Packets that arrive later are computed on
        arrival. Raises NotFound, BadInput."""
        self._derived.parameter(name)
        end = min(end, self._now())
        if not start < end or end - start > MAX_SPAN:
            raise BadInput(
                "The time span is empty or too long",
                expected=f"a start before the end and before now, at most {MAX_SPAN.days} days",
                got=f"{start.isoformat()} … {end.isoformat()}",
            )
        request = DeriveJob(name, start, end, user=user)
        return self._jobs.begin("derive", f"recompute {name}", request)

    def _work(self, request: DeriveJob, run: JobRun) -> JobResult:
        parameter = self._derived.parameter(request.name)
        recomputed = Recomputed(**run.checkpoint) if run.checkpoint else Recomputed(request.start.isoformat())
        at = datetime.fromisoformat(recomputed.at)
        total = int((request.end - request.start) / STEP) + 1
        while at < request.end:
            run.progress(int((at - request.start) / STEP), total, f"{at:%Y-%m-%d %H:%M} UTC")
            step = self._next_step(parameter, at, request.end)
            rows = list(self._computed(parameter, step))
            unknown = sum(row["values"][parameter.field.name] is None for row in rows)
            recomputed = Recomputed(
                step.end.isoformat(), recomputed.values + len(rows) - unknown, recomputed.unknown + unknown
            )
            with self._database.unit_of_work() as session:
                store.replace(session, parameter.packet.name, step.start, step.end, rows)
                run.keep(asdict(recomputed), session)
            at = step.end
        return {"values": recomputed.values, "unknown": recomputed.unknown}

    def _next_step(self, parameter: ComputedParameter, at: datetime, end: datetime) -> _TimeStep:
        """Return the next time span to replace, at most ``STEP`` long. It starts at the first stored packet from ``at``
        on."""
        with self._database.unit_of_work() as session:
            names = [*parameter.fresh_s, parameter.packet.name]
            first = store.first_received(session, names, at, end)
        start = end if first is None else first
        return _TimeStep(start, min(start + STEP, end))

    def _computed(self, parameter: ComputedParameter, step: _TimeStep) -> Iterator[Mapping[str, Any]]:
        """Yield the rows of a time step. Earlier packets are also read, because their values can still be current at
        its start."""
        newest: dict[str, tuple[datetime, Values]] = {}
        for row, values in self._packets(parameter, step):
            newest[row.packet] = (row.received, values)
            if row.received < step.start:
                continue
            result = parameter.evaluate(newest.get, row.received)
            yield {
                "contact_id": row.contact_id,
                "packet": parameter.packet.name,
                "received": row.received,
                "device_time_s": row.device_time_s,
                "request_id": 0,
                "values": plain_values(parameter.telemetry(result, row.device_time_s).values),
            }

    def _current_from(self, parameter: ComputedParameter, packet: str, start: datetime) -> datetime:
        """Return from when on packets of a kind can be current at ``start``. Without a limit of age, the last one is current."""
        fresh_s = parameter.fresh_s[packet]
        if fresh_s:
            return start - timedelta(seconds=fresh_s)
        with self._database.unit_of_work() as session:
            return store.last_received(session, packet, start) or start

    def _packets(self, parameter: ComputedParameter, step: _TimeStep) -> Iterator[tuple[packets.Row, Values]]:
        """Yield the packets that the parameter refers to, with the fields that it uses, oldest first: those of a time step, and
        earlier ones that can still be current at its start."""
        fields: dict[str, list[str]] = {}
        for reference in parameter.expression.references:
            fields.setdefault(reference.packet, []).append(reference.field)
        booleans, last = self._derived.boolean_fields, step.end - timedelta(microseconds=1)
        streams = [
            packets.rows(self._database, packet, names, self._current_from(parameter, packet, step.start), last)
            for packet, names in fields.items()
        ]
        for row in heapq.merge(*streams, key=lambda row: (row.received, row.id)):
            values: dict[str, Value] = {}
            for name, value in zip(fields[row.packet], row.values, strict=True):
                if value is not None:
                    values[name] = bool(value) if f"{row.packet}.{name}" in booleans else value
            yield row, values
