"""Checks of a third-party sensor against its package. Only declared operations and telemetry are checked.

Hazardous commands are sent only if ``write`` is True. Commands without values for all arguments are skipped.
"""

from __future__ import annotations

from gss.device.session_events import LinkCounters
from gss.domain.errors import BadInput, Conflict, LinkDown
from gss.instruments.dictionary.definitions import Hazard
from gss.instruments.operations import Operation, StandardOperations
from gss.instruments.package import Instrument
from gss.operations.checks.check_findings import Case, shown
from gss.operations.checks.direct import DirectDevice

NOISE = bytes(range(1, 40))
WATCH_LEAST_S = 3.0


def check_declared(device: DirectDevice, instrument: Instrument, *, write: bool) -> list[Case]:
    """Return the result of each test: identity, operations, telemetry, and noise on the line."""
    hello, operations = device.hello, instrument.roles.operations
    cases = [Case("the sensor answers", True, f"{hello.profile}, dictionary {hello.dictionary_hash[:12]}")]
    with_command = [o for o in operations.names() if operations.require(o).command is not None]
    stop = [o for o in with_command if o is Operation.STOP_CYCLE]
    cases += [_check_operation(device, operations, o, write) for o in with_command if o not in stop]
    # Runs before STOP_CYCLE, because some sensors report an attitude only while the cycle runs.
    cases += _check_telemetry(device, instrument)
    cases += [_check_operation(device, operations, o, write) for o in stop]
    device.disturb(NOISE)
    cases.append(_after_noise(device, instrument))
    return cases


def _check_operation(device: DirectDevice, operations: StandardOperations, operation: Operation, write: bool) -> Case:
    command = operations.dictionary.command(operations.command(operation))
    subject = f"{operation.value} ({command.name})"
    if command.hazard.rank >= Hazard.WARNING.rank and not write:
        return Case(subject, None, f"{command.hazard}: {command.hazard_reason}")
    arguments = operations.call(operation).arguments
    missing = [a.name for a in command.arguments if a.default is None and a.name not in arguments]
    if missing:
        return Case(subject, None, f"no default for {', '.join(missing)}")
    try:
        done = device.command(command.name, arguments)
    except (Conflict, LinkDown, BadInput) as error:
        return Case(subject, False, str(error))
    return Case(subject, True, ", ".join(f"{name} {shown(value)}" for name, value in done.values.items()))


def _check_telemetry(device: DirectDevice, instrument: Instrument) -> list[Case]:
    """Check that each packet of a standard quantity has arrived and contains the fields that the package names."""
    roles = instrument.roles.quantities.roles()
    longest_s = max((instrument.dictionary.packet(r.packet).stale_after_s for r in roles.values()), default=0.0)
    events = device.watch(max(WATCH_LEAST_S, min(longest_s, 20.0)))
    cases = []
    for name, role in roles.items():
        packet = device.packets.get(role.packet)
        subject = f"{name} ({role.packet})"
        if packet is None:
            cases.append(Case(subject, False, "no packet was received"))
            continue
        content = {**packet.values, **packet.lists}
        absent = [field for field in role.fields().values() if field not in content]
        cases.append(Case(subject, not absent, f"without {', '.join(absent)}" if absent else ""))
    last = next((e for e in reversed(events) if isinstance(e, LinkCounters)), None)
    if last is not None:
        bad = last.received.bad + last.received.undecodable + last.received.unknown
        cases.append(Case("frames that can be read", bad == 0, f"{last.received.good} good, {bad} others"))
    return cases


def _after_noise(device: DirectDevice, instrument: Instrument) -> Case:
    """Check that the device answers a request after noise on the line."""
    operations, subject = instrument.roles.operations, "answers after noise on the line"
    safe = [o for o in (Operation.HELLO, Operation.GET_STATUS) if operations.has(o) and operations.command(o)]
    if not safe:
        return Case(subject, None, "the package declares neither hello nor get_status")
    try:
        device.command(operations.command(safe[0]), {})
    except (Conflict, LinkDown) as error:
        return Case(subject, False, str(error))
    return Case(subject, True)
