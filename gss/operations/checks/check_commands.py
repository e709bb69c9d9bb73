"""Conformance checks of commands: rejections, repeated ids, range limits, preconditions. Hazardous commands are never
executed."""

from __future__ import annotations

import math
from collections.abc import Iterator

from gss.device.protocol.codec import STRUCT, encode_item
from gss.instruments.dictionary.definitions import (
    FLOATS,
    INTEGER_RANGES,
    Argument,
    CommandDefinition,
    Hazard,
    Precondition,
    Value,
)
from gss.operations.checks.check_findings import Findings, shown
from gss.operations.checks.probe import FINAL, CommandOutcome, Probe

ORDER = {"accepted": 0, "started": 1, "progress": 2, "completed": 3, "failed": 3}
APART = ("HELLO", "ABORT")
"""Commands that separate clauses cover."""
NO_HAZARD_ONLY = "hazardous: not executed"
Orders = tuple[tuple[str, dict[str, Value]], ...]
BREAK: dict[tuple[str, str], Orders] = {
    ("mode", "ne"): (("STOP_CYCLE", {}), ("SET_MODE", {"mode": "standby"})),
    ("cycle_running", "eq"): (("SET_MODE", {"mode": "lost_in_space"}), ("START_CYCLE", {})),
}
"""Commands that violate a precondition on a housekeeping field."""
RESTORE: Orders = (("STOP_CYCLE", {}), ("SET_MODE", {"mode": "lost_in_space"}))
HARD = (Hazard.WARNING, Hazard.CRITICAL)
NOT_CARRIED_OUT: dict[str, str] = {
    "SET_TIME": "would set the clock; whether it was set before cannot be read back",
    "CANCEL": "would cancel commands that a user scheduled",
    "SCHEDULE": "would stay in the schedule",
}
"""Commands whose range limits are not tested, because separate clauses cover them or the ground cannot restore the state."""
AFTERWARDS: dict[str, Orders] = {"SET_APRIORI": (("SET_APRIORI", {"uncertainty_deg": 180.0}),)}
"""Commands that restore the state after the range limits of a command were tested."""


def check_refusals(probe: Probe, findings: Findings) -> None:
    """Check clauses 4.5, 4.6 and 4.7."""
    dictionary = probe.dictionary
    assigned_codes = {c.code for c in dictionary.commands}
    for code in (next(c for c in range(255, 0, -1) if c not in assigned_codes), 0):
        answer = probe.raw(code, b"")
        findings.check("4.5", f"code {code}", answer.is_("rejected", "unknown_command"), answer.text)
    for name, payload in (("GET_STATUS", b"\0"), ("SET_EXPOSURE", b"\0"), ("SET_EXPOSURE", b"\0\1\0")):
        command = dictionary.command(name)
        answer = probe.raw(command.code, payload, command=command)
        is_rejected = answer.is_("rejected", "bad_length")
        findings.check("4.6", f"{name} with {len(payload)} B", is_rejected, answer.text)
    command = dictionary.command("GET_STATUS")
    answer = probe.raw(command.code, b"", command=command, prefix=dictionary.prefix ^ 0xFFFF)
    findings.check("4.7", "GET_STATUS", answer.is_("rejected", "wrong_dictionary"), answer.text)
    for name in ("HELLO", "ABORT"):
        command = dictionary.command(name)
        answer = probe.raw(command.code, b"", command=command, prefix=dictionary.prefix ^ 0xFFFF)
        findings.check("4.7", f"{name} (any prefix is accepted)", answer.is_("completed"), answer.text)


def check_repeats(probe: Probe, findings: Findings) -> None:
    """Check clauses 4.9 and 4.10, with a command that must not be executed twice."""
    first = probe.order("TAKE_IMAGE", {"slot": 0})
    if not findings.check("4.9", "TAKE_IMAGE, first", first.is_("completed"), first.text):
        return
    frames = probe.status()["last_frame"]
    again = probe.order("TAKE_IMAGE", {"slot": 0}, request_id=first.request_id)
    replayed = again.is_("completed") and again.last is not None and again.last.replayed
    findings.check("4.9", "TAKE_IMAGE, again: the stored report", replayed, again.text)
    equal_values = first.last is not None and again.last is not None and first.last.values == again.last.values
    findings.check("4.9", "TAKE_IMAGE, again: the same values", equal_values)
    now = probe.status()["last_frame"]
    findings.check(
        "4.9", "TAKE_IMAGE, again: no second image", now == frames, f"frame {shown(frames)}, then {shown(now)}"
    )
    other = probe.order("TAKE_IMAGE", {"slot": 1}, request_id=first.request_id)
    findings.check("4.10", "TAKE_IMAGE of another slot", other.is_("rejected", "id_reused"), other.text)
    other = probe.order("LIST_FRAMES", request_id=first.request_id)
    findings.check("4.10", "another command", other.is_("rejected", "id_reused"), other.text)
    hello = probe.order("HELLO")
    again = probe.order("HELLO", request_id=hello.request_id)
    fresh = again.is_("completed") and again.last is not None and not again.last.replayed
    findings.check("4.9", "HELLO, again: executed again", fresh, again.text)


def check_old_ids(probe: Probe, findings: Findings, oldest: int) -> None:
    """Check clause 4.21. ``oldest``: request id of a command sent before at least 64 others."""
    for subject, request_id in (("id 0", 0), ("an id from before the last 64", oldest)):
        answer = probe.order("TAKE_IMAGE", {"slot": 0}, request_id=request_id)
        findings.check("4.21", subject, answer.is_("rejected", "id_reused"), answer.text)


def check_boundaries(probe: Probe, findings: Findings, *, write: bool) -> None:
    """Check clauses 4.3 and 4.4, and check each answer against clauses 4.1, 4.2 and 2.4. ``write``: also send hazardous
    commands with arguments out of range, which a conforming device rejects."""
    for command in probe.dictionary.commands:
        if command.name in APART or (command.simulator_only and not probe.device.hello.simulated):
            continue
        for argument, value, payload in _outside(probe, command):
            subject = f"{command.name} {argument.name} = {shown(value)}"
            if command.hazard in HARD and not write:
                findings.skip("4.4", subject, f"{NO_HAZARD_ONLY} without --write")
                continue
            answer = probe.raw(command.code, payload, command=command)
            findings.check("4.4", subject, answer.is_("rejected", "out_of_range"), answer.text)
        left_out = NO_HAZARD_ONLY if command.hazard in HARD else NOT_CARRIED_OUT.get(command.name, "")
        if command.simulator_only:
            left_out = "injects a fault"
        if left_out:
            findings.skip("4.3", command.name, left_out)
            continue
        _make_ready(probe, command)
        for subject, arguments in _ends(command):
            if command.hazard_for(arguments)[0] in HARD:
                findings.skip("4.3", subject, NO_HAZARD_ONLY)
                continue
            answer = probe.order(command.name, arguments)
            if arguments:
                findings.check("4.3", subject, answer.accepted, answer.text)
            _check_life(findings, subject, command, answer)
            _make_ready(probe, command)
        for name, values in AFTERWARDS.get(command.name, ()):
            probe.order(name, values)


def _ends(command: CommandDefinition) -> Iterator[tuple[str, dict[str, Value]]]:
    """Yield sets of arguments. In each set one argument is at its minimum or maximum and all others are at their defaults."""
    if not command.arguments:
        yield command.name, {}
    for argument in command.arguments:
        ends: tuple[Value | None, ...] = (argument.minimum, argument.maximum)
        if argument.choices:
            numbered = sorted(argument.choices, key=lambda c: c.value)
            ends = (numbered[0].name, numbered[-1].name)
        for value in ends:
            if value is not None:
                yield f"{command.name} {argument.name} = {shown(value)}", {argument.name: value}


def _outside(probe: Probe, command: CommandDefinition) -> Iterator[tuple[Argument, Value, bytes]]:
    """Yield each argument with values outside its limits, and the encoded payload. Values that the type cannot represent are
    omitted."""
    for argument in command.arguments:
        for value in _beyond(argument):
            parts = [_raw(other, value if other is argument else None, probe, command) for other in command.arguments]
            yield argument, value, b"".join(parts)


def _beyond(argument: Argument) -> list[float]:
    if argument.choices:
        return [max(c.value for c in argument.choices) + 1]
    if argument.minimum is None or argument.maximum is None:
        return []
    values = [argument.minimum - 1, argument.maximum + 1]
    if argument.type in FLOATS:
        return [*values, math.nan, math.inf]
    low, high = INTEGER_RANGES[argument.type]
    return [int(v) for v in values if low <= v <= high]


def _raw(argument: Argument, value: float | None, probe: Probe, command: CommandDefinition) -> bytes:
    """Encode a value without a range check; None encodes the default."""
    if value is None:
        default = argument.default if argument.default is not None else argument.minimum
        return encode_item(argument, default if default is not None else 0)
    return STRUCT[argument.type].pack(value)


def _check_life(findings: Findings, subject: str, command: CommandDefinition, answer: CommandOutcome) -> None:
    """Check the order of stages and the codes of reports, and check that a final report arrives in time."""
    stages = [r.stage for r in answer.reports]
    ranks = [ORDER.get(s, -1) for s in stages]
    in_order = bool(stages) and stages[0] == "accepted" and ranks == sorted(ranks) and stages.count("accepted") == 1
    findings.check("4.1", subject, in_order and "started" in stages, answer.text)
    done = answer.last is not None and answer.last.stage in FINAL
    slow = "" if done else f"not within {command.accept_s:g} s + {command.complete_s:g} s"
    findings.check("4.2", subject, done, slow or answer.text)
    findings.check("2.4", f"{subject}: code of the reports", all(r.code == command.code for r in answer.reports))


def _make_ready(probe: Probe, command: CommandDefinition) -> None:
    """Restore the preconditions of a command, and stop the cycle because it would disturb timing."""
    if command.preconditions or command.name in ("SET_MODE", "START_CYCLE"):
        for name, arguments in RESTORE:
            probe.order(name, arguments)


def check_conditions(probe: Probe, findings: Findings) -> None:
    """Check clause 4.8 by making each precondition of each command fail once."""
    for command in probe.dictionary.commands:
        for condition in command.preconditions:
            subject = f"{command.name}: not “{condition.text}”"
            if command.hazard in HARD:
                findings.skip("4.8", subject, NO_HAZARD_ONLY)
            elif (condition.field, condition.op) not in BREAK:
                findings.skip("4.8", subject, "no known command makes it fail")
            else:
                _check_condition(probe, findings, subject, command, condition)
    for name, arguments in RESTORE:
        probe.order(name, arguments)


def _check_condition(
    probe: Probe, findings: Findings, subject: str, command: CommandDefinition, condition: Precondition
) -> None:
    for name, arguments in BREAK[condition.field, condition.op]:
        probe.order(name, arguments)
    if condition.met(probe.status()) is not False:
        findings.check("4.8", subject, False, "could not make the condition fail")
        return
    answer = probe.order(command.name)
    findings.check("4.8", subject, answer.is_("rejected", "wrong_state"), answer.text)
