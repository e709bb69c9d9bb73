"""``gss rehearse``: execute a pass plan on a simulated unit, faster than real time. The server can be running; nothing
is sent to its unit."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from gss.cli import Commands
    from gss.operations.rehearsals.rehearsal_report import RehearsalReport


def register(subparsers: Commands) -> None:
    """Add the command."""
    parser = subparsers.add_parser(
        "rehearse",
        description="Execute a pass plan on a simulated unit with the rise and set times and the horizon mask of its real "
        "passes. It runs in a separate process and a temporary store and cannot reach a real line. Exit code 0: the plan "
        "was completed; 1: it was not.",
    )
    parser.add_argument("plan", type=int, nargs="?", help="number of the plan")
    parser.add_argument("--answer", action="append", default=[], metavar="STEP=ANSWER", help="answer to a question")
    parser.add_argument(
        "--person", type=float, default=10.0, metavar="S", help="time that a person needs for a step (default 10)"
    )
    parser.add_argument(
        "--loss",
        action="append",
        default=[],
        metavar="PASS:AFTER:FOR",
        help="lose the signal in pass number PASS, AFTER seconds after its rise, for FOR seconds",
    )
    parser.add_argument(
        "--drop-rate", type=float, default=0.0, metavar="X", help="share of 64-byte blocks lost (default 0)"
    )
    parser.add_argument(
        "--bit-error-rate", type=float, default=0.0, metavar="X", help="bit error rate in both directions (default 0)"
    )
    parser.add_argument("--seed", type=int, default=1, help="seed of noise and faults (default 1)")
    parser.add_argument("--json", action="store_true", help="print the report as JSON")
    parser.add_argument("--data", type=Path, help="data folder (GSS_DATA)")
    parser.add_argument("--prepared", type=Path, help="prepared folder; used by the server's own process")
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Rehearse the plan and print the report."""
    from gss.cli.records import services_of
    from gss.domain.errors import BadInput
    from gss.operations.rehearsals.rehearsal_report import REPORT, RehearsalOptions
    from gss.operations.requests import request_from

    if arguments.prepared is not None:
        return run_prepared(arguments.prepared)
    if arguments.plan is None:
        raise BadInput("no plan given", expected="gss rehearse NUMBER")
    options = request_from(
        RehearsalOptions,
        {
            "answers": dict(_pair(text) for text in arguments.answer),
            "person_s": arguments.person,
            "outages": [_outage(text) for text in arguments.loss],
            "bit_error_rate": arguments.bit_error_rate,
            "drop_rate": arguments.drop_rate,
            "seed": arguments.seed,
        },
    )
    progress = _show if sys.stderr.isatty() else lambda share, text: None
    report = services_of(arguments).passes.rehearsals.run(arguments.plan, options, progress)
    if sys.stderr.isatty():
        print(file=sys.stderr)
    if arguments.json:
        print(REPORT.dump_json(report, indent=1).decode())
    else:
        _print(report)
    return 0 if report.state == "completed" else 1


def run_prepared(folder: Path) -> int:
    """Rehearse the plan in a prepared folder. Print progress and report as lines of JSON."""
    from gss.domain.errors import GssError
    from gss.operations.rehearsals.rehearsal_report import REPORT
    from gss.rehearsing import rehearse

    try:
        report = rehearse(folder, lambda share, text: _line({"share": share, "text": text}))
    except GssError as error:
        _line({"error": str(error)})
        return 1
    _line({"report": REPORT.dump_python(report, mode="json")})
    return 0


def _line(message: dict[str, object]) -> None:
    sys.stdout.write(json.dumps(message) + "\n")
    sys.stdout.flush()


def _show(share: float, text: str) -> None:
    sys.stderr.write(f"\r{share:4.0%} {text}\033[K")
    sys.stderr.flush()


def _pair(text: str) -> tuple[str, str]:
    from gss.domain.errors import BadInput

    name, sign, value = text.partition("=")
    if not sign:
        raise BadInput("the answer cannot be read", expected="STEP=ANSWER", got=text[:80])
    return name, value


def _outage(text: str) -> dict[str, float | int]:
    from gss.domain.errors import BadInput

    try:
        number, after, duration = text.split(":")
        return {"pass_number": int(number), "after_s": float(after), "for_s": float(duration)}
    except ValueError:
        raise BadInput("the loss cannot be read", expected="PASS:AFTER:FOR, such as 1:120:60", got=text[:80]) from None


def _print(report: RehearsalReport) -> None:
    speed = report.simulated_s / report.real_s if report.real_s else 0.0
    print(f"{report.plan}: {report.state}" + (f", {report.reason}" if report.reason else ""))
    print(f"{report.simulated_s:.0f} s rehearsed in {report.real_s:.0f} s ({speed:.0f} times real time)")
    print(f"\n{'pass, UTC':<31} {'window':>8} {'used':>8} {'up':>9} {'down':>9}")
    for rehearsed in report.passes:
        print(
            f"{rehearsed.rise:%Y-%m-%d %H:%M:%S} – {rehearsed.set:%H:%M:%S}  {rehearsed.window_s:6.0f} s {rehearsed.used_s:6.0f} s "
            f"{rehearsed.bytes_up:7d} B {rehearsed.bytes_down:7d} B"
        )
    print(f"\n{'item':<44} {'state':<9} {'planned':>8} {'took':>8}")
    for item in report.items:
        print(f"{item.title[:44]:<44} {item.state:<9} {item.estimated_s:6.0f} s {item.active_s:6.0f} s  {item.detail}")
    print("\nplan")
    for change in report.transitions:
        print(f"  {change.at:%Y-%m-%d %H:%M:%S}  {change.state:<10} {change.reason}")
    for step in report.person:
        print(f"  {step.at:%Y-%m-%d %H:%M:%S}  {step.user}: {step.kind} {step.step} {step.answer}".rstrip())
