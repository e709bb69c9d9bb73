"""Stacks and their runs as responses."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from gss.api.present.commands import arguments_text, byte_groups, precondition
from gss.api.schemas.stacks import StackCheckOut, StackOut, StackRunOut, StepCheckOut
from gss.operations.commanding.stacks import StackCheck, StepCheck
from gss.store.models import Stack, StackRun


def stack(row: Stack) -> StackOut:
    """Return a stack."""
    return StackOut.model_validate(row)


def check(result: StackCheck, names: Callable[[str], Sequence[str]]) -> StackCheckOut:
    """Return the result of a dry run. ``names``: returns the argument names of a command."""
    steps = [_step(k, step, names(step.command)) for k, step in enumerate(result.steps)]
    return StackCheckOut(
        steps=steps,
        problems=list(result.problems),
        confirm=list(result.confirm),
        size=sum(step.size for step in steps),
        shortest_s=result.shortest_s,
        longest_s=result.longest_s,
    )


def _step(index: int, step: StepCheck, names: Sequence[str]) -> StepCheckOut:
    return StepCheckOut(
        index=index,
        command=step.command,
        text=arguments_text(step.arguments),
        hazard=step.risk.hazard.value,
        hazard_reason=step.risk.reason,
        confirm_name=step.risk.name,
        role=step.role,
        preconditions=[precondition(s) for s in step.preconditions],
        problems=list(step.problems),
        bytes=byte_groups(step.groups, names),
        size=sum(len(data) for _, data in step.groups),
        delay_s=step.delay_s,
        wait_s=step.wait_s,
        within_s=step.within_s,
    )


def run(row: StackRun) -> StackRunOut:
    """Return a stack run."""
    return StackRunOut.model_validate(row)
