"""``gss check device``: check a simulator or a real unit against the interface document."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from gss.cli import instruments, records, upkeep
from gss.domain.errors import BadInput

if TYPE_CHECKING:
    from gss.cli import Commands
    from gss.instruments.package import Instrument
    from gss.operations.checks.check_findings import DeviceRecord, Findings

DESCRIPTION = """Test a device on a port against each clause of docs/icd.md, or a third-party sensor against the operations and
telemetry that its package declares. The port must be free and the device idle. During the test the cycle is stopped, image
memories are overwritten and the attitude hint is cleared; settings, mode and cycle are restored afterwards. Hazardous
commands are not executed. Exit code 0: no clause failed; 1: a clause failed."""


def register(subparsers: Commands) -> None:
    """Add the ``check`` commands."""
    parser = subparsers.add_parser("check")
    subcommands = parser.add_subparsers(dest="kind", required=True, metavar="WHAT")
    p = subcommands.add_parser("device", help="test a simulator or a unit on a port", description=DESCRIPTION)
    p.add_argument(
        "--device",
        required=True,
        metavar="URL",
        help="port of the device: a tty, or a socket://, rfc2217://, udp://, zmq:// or can:// URL",
    )
    p.add_argument(
        "--write",
        action="store_true",
        help="also upload into an inactive bank, which is restored afterwards, and send hazardous commands with "
        "invalid arguments to check that the device rejects them",
    )
    instruments.add_option(p)
    p.add_argument("--keys", type=Path, metavar="FILE", help="sign packets with these link keys")
    p.add_argument("--json", action="store_true", help="print one JSON object with every check")
    p.set_defaults(run=run)
    records.register_checks(subcommands)
    upkeep.register_check(subcommands)


def run(arguments: argparse.Namespace) -> int:
    """Run the checks and print the findings."""
    from gss.device.link_keys import packet_signer
    from gss.operations.checks.check_device import check_device
    from gss.operations.checks.probe import probing
    from gss.operations.clock import monotonic_s, utc_us

    instrument = instruments.chosen(arguments)
    dictionary = instrument.dictionary
    if not dictionary.services:  # the interface document covers only the shared protocol
        if arguments.keys:
            raise BadInput("the protocol of this instrument has no link keys", got=f"--keys with {instrument.name}")
        return _run_declared(arguments, instrument)
    signer = packet_signer(arguments.keys, utc_us) if arguments.keys else None
    with probing(arguments.device, dictionary, monotonic_s, signer) as probe:
        findings = check_device(probe, write=arguments.write, on_part=_show_part)
        facts = findings.plain(probe.device.hello, dictionary.hash_hex)
    if arguments.json:
        print(json.dumps(facts))
    else:
        _print(findings, facts["device"])
    return 1 if findings.failed or findings.not_restored else 0


def _run_declared(arguments: argparse.Namespace, instrument: Instrument) -> int:
    """Test the operations and telemetry that the package of a third-party sensor declares."""
    from dataclasses import asdict

    from gss.operations.checks.check_declared import check_declared
    from gss.operations.checks.direct import direct_device
    from gss.operations.clock import monotonic_s

    with direct_device(arguments.device, instrument, monotonic_s) as device:
        cases = check_declared(device, instrument, write=arguments.write)
    failed = [case for case in cases if case.passed is False]
    if arguments.json:
        facts = {"instrument": instrument.name, "failed": len(failed), "cases": [asdict(case) for case in cases]}
        print(json.dumps(facts))
        return 1 if failed else 0
    print(f"{instrument.name}: {instrument.about.title}")
    for case in cases:
        label = {True: "pass", False: "FAILED", None: "skipped"}[case.passed]
        print(f"{label:9} {case.subject}{': ' if case.detail else ''}{case.detail}")
    executed = [case for case in cases if case.passed is not None]
    print(f"{len(executed)} test cases, {len(failed)} failed")
    return 1 if failed else 0


def _show_part(part: str) -> None:
    if sys.stderr.isatty():
        print(f"… {part}", file=sys.stderr, flush=True)


def _print(findings: Findings, device: DeviceRecord) -> None:
    """Print one line per clause, with the cases that failed or were skipped below it."""
    from gss.device.clauses import CLAUSES
    from gss.operations.checks.check_findings import NOT_CHECKED

    print(f"{device['serial']}: {device['device_model']}, {device['profile']}, firmware {device['firmware']}")
    for clause in CLAUSES:
        result, cases = findings.result(clause), findings.cases.get(clause.number, [])
        print(f"{result:11} {clause.number:5} {clause.text}")
        if result == NOT_CHECKED and not cases:
            print(f"{'':17} {clause.unchecked or 'the check ended before this clause'}")
        for case in cases:
            if case.passed is not True:
                label = "skipped" if case.passed is None else "FAILED"
                print(f"{'':17} {label}: {case.subject}: {case.detail}")
    for text in findings.not_restored:
        print(f"NOT RESTORED: {text}")
    if findings.damaged:
        print(
            f"{findings.damaged} packets were damaged, so the line may have caused the failures. Repeat on an error-free line"
        )
    executed = [c for cases in findings.cases.values() for c in cases if c.passed is not None]
    print(
        f"{len(executed)} test cases, {sum(not c.passed for c in executed)} failed; failed clauses: {len(findings.failed)}"
    )
