"""The device's command schedule as a response."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, datetime

from gss.api.present.commands import arguments_text, byte_groups
from gss.api.schemas.schedule import DeviceClockOut, EntryOut, ScheduleCheckOut, ScheduleOut
from gss.operations.commanding.schedule import Entry, ScheduleState
from gss.operations.commanding.schedule_plan import Plan
from gss.operations.line.clock_correlation import Correlation


def schedule(state: ScheduleState) -> ScheduleOut:
    """Return the schedule with the clock correlation."""
    return ScheduleOut(
        entries=[_entry(entry) for entry in state.entries],
        reported=state.listed_at,
        complete=state.complete,
        clock=_clock(state.clock) if state.clock else None,
    )


def _clock(clock: Correlation) -> DeviceClockOut:
    return DeviceClockOut(
        device_s=clock.device_s,
        utc=datetime.fromtimestamp(clock.utc_s, UTC),
        uncertainty_s=clock.uncertainty_s,
        drift_ppm=None if clock.drift is None else clock.drift * 1e6,
        samples=clock.samples,
        span_s=clock.span_s,
    )


def _entry(entry: Entry) -> EntryOut:
    arguments = {k: v.hex() if isinstance(v, bytes) else v for k, v in entry.arguments.items()}
    return EntryOut(
        schedule_id=entry.schedule_id,
        at_device_s=entry.at_device_s,
        at=entry.at,
        uncertainty_s=entry.uncertainty_s,
        command=entry.command,
        arguments=arguments,
        text=arguments_text(arguments),
        hazard=entry.hazard.value,
        state=entry.state,  # type: ignore[arg-type]  # the dictionary's values
        reason=entry.reason,
        hex=entry.payload.hex(" "),
    )


def plan(result: Plan, groups: Sequence[tuple[str, bytes]], names: Sequence[str]) -> ScheduleCheckOut:
    """Return the result of a dry run."""
    return ScheduleCheckOut(
        problems=list(result.problems),
        warnings=list(result.warnings),
        at_device_s=result.at_device_s,
        at=result.at,
        uncertainty_s=result.uncertainty_s,
        hazard=result.risk.hazard.value,
        hazard_reason=result.risk.reason,
        confirm_name=result.risk.name,
        role=result.role,
        bytes=byte_groups(groups, names),
        size=sum(len(data) for _, data in groups),
    )
