"""``gss check device``: check a simulator or a real unit against the interface document."""

from __future__ import annotations

import argparse
import json
import sys
from typing import TYPE_CHECKING

from gss.cli import records, upkeep

if TYPE_CHECKING:
    from gss.cli import Commands
    from gss.operations.checks.check_findings import Findings

DESCRIPTION = """Try a device on a port against each clause of docs/icd.md. The port must be free and the device idle: the
cycle is stopped for the time, image memories are overwritten and the attitude hint is lost; settings, mode and cycle are given
back. Commands with a hazard are not carried out. Exit code 0: nothing failed; 1: something did."""


def register(subparsers: Commands) -> None:
    """Add the commands."""
    parser = subparsers.add_parser("check")
    kinds = parser.add_subparsers(dest="kind", required=True, metavar="WHAT")
    p = kinds.add_parser("device", help="a simulator or a unit on a port", description=DESCRIPTION)
    p.add_argument(
        "--device", required=True, metavar="URL", help="port of the device: a tty, socket:// or rfc2217:// URL"
    )
    p.add_argument(
        "--write",
        action="store_true",
        help="also upload into an inactive bank, which then holds what it held before, and offer commands with a hazard "
        "arguments that they must reject",
    )
    p.add_argument("--json", action="store_true", help="print one JSON object with every trial")
    p.set_defaults(run=run)
    records.register_checks(kinds)
    upkeep.register_check(kinds)


def run(arguments: argparse.Namespace) -> int:
    """Run the checks and print the findings."""
    from gss.device.dictionary_file import load_dictionary
    from gss.operations.checks.check_device import check_device
    from gss.operations.checks.probe import probing
    from gss.operations.clock import monotonic_s

    dictionary = load_dictionary()
    with probing(arguments.device, dictionary, monotonic_s) as probe:
        findings = check_device(probe, write=arguments.write, told=_told)
        facts = findings.plain(probe.device.hello, dictionary.hash_hex)
    if arguments.json:
        print(json.dumps(facts, ensure_ascii=False))
    else:
        _print(findings, facts["device"])
    return 1 if findings.failed or findings.left else 0


def _told(part: str) -> None:
    if sys.stderr.isatty():
        print(f"… {part}", file=sys.stderr, flush=True)


def _print(findings: Findings, device: dict[str, object]) -> None:
    """Print one line per clause, with the cases that failed or were skipped below it."""
    from gss.device.clauses import CLAUSES
    from gss.operations.checks.check_findings import NOT_CHECKED

    print(f"{device['serial']}: {device['device_model']}, {device['profile']}, firmware {device['firmware']}")
    for clause in CLAUSES:
        result, cases = findings.result(clause), findings.cases.get(clause.number, [])
        print(f"{result:11} {clause.number:5} {clause.text}")
        if result == NOT_CHECKED and not cases:
            print(f"{'':17} {clause.unchecked or 'the check ended before'}")
        for case in cases:
            if case.passed is not True:
                word = "left out" if case.passed is None else "FAILED"
                print(f"{'':17} {word}: {case.subject}: {case.detail}")
    for text in findings.left:
        print(f"NOT GIVEN BACK: {text}")
    if findings.damaged:
        print(f"{findings.damaged} packets came damaged: what failed may be the line's fault; try again on a clean one")
    tried = [c for cases in findings.cases.values() for c in cases if c.passed is not None]
    print(
        f"{len(tried)} trials, {sum(not c.passed for c in tried)} failed; clauses that do not hold: {len(findings.failed)}"
    )
