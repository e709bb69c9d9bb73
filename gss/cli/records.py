"""Commands for recorded data: ``gss export telemetry``, ``gss export contact-report``, ``gss check record``."""

from __future__ import annotations

import argparse
import atexit
import json
import sys
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

from gss.cli.whole_files import write_pieces, write_whole

if TYPE_CHECKING:
    from gss.api.schemas.contacts import RecordOut
    from gss.wiring.services import Services

    Kinds = argparse._SubParsersAction[argparse.ArgumentParser]


def register_exports(kinds: Kinds) -> None:
    """Add the commands to ``gss export``."""
    parser = kinds.add_parser("telemetry", help="export telemetry fields over a time range as CSV, Parquet or HDF5")
    parser.add_argument(
        "--fields", required=True, help="names, for example mode,attitude.ra_deg; packet.name if the name is ambiguous"
    )
    parser.add_argument("--from", dest="start", metavar="TIME", help="start, ISO 8601, UTC by default")
    parser.add_argument("--to", dest="end", metavar="TIME", help="end, ISO 8601")
    parser.add_argument("--contact", type=int, metavar="N", help="use the time range of this contact")
    parser.add_argument("--format", default="csv", choices=("csv", "parquet", "hdf5"))
    parser.add_argument(
        "--form", default="converted", choices=("converted", "raw", "formatted"), help="default converted"
    )
    parser.add_argument("--out", type=Path, help="file to write; standard output without it")
    _with_data(parser).set_defaults(run=export_telemetry)
    parser = kinds.add_parser("contact-report", help="write the pass report of a contact")
    parser.add_argument("--contact", type=int, required=True, metavar="N")
    parser.add_argument("--format", default="html", choices=("html", "pdf", "json"), help="default html")
    parser.add_argument("--out", type=Path, help="file to write; standard output without it")
    _with_data(parser).set_defaults(run=export_report)


def register_checks(kinds: Kinds) -> None:
    """Add the command to ``gss check``."""
    parser = kinds.add_parser(
        "record",
        help="list gaps of the stored housekeeping",
        description="List every gap of the stored housekeeping with its cause. "
        "Exit code 0: every gap has a known cause; 1: a gap has no known cause.",
    )
    parser.add_argument("--contact", type=int, metavar="N", help="number of the contact (default: the newest)")
    parser.add_argument("--all", action="store_true", help="check every contact")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    _with_data(parser).set_defaults(run=check_record)


def _with_data(parser: argparse.ArgumentParser) -> argparse.ArgumentParser:
    parser.add_argument("--data", type=Path, help="data folder (GSS_DATA)")
    return parser


def services_of(arguments: argparse.Namespace, backups: Path | None = None) -> Services:
    """Return the store's services without starting them, so that a running server is not disturbed. ``backups``: folder
    of the backups, if it differs from the settings."""
    from gss.domain.errors import NotFound
    from gss.settings import Settings
    from gss.wiring.build import build

    settings = Settings(**({"data": arguments.data} if arguments.data else {}))
    if backups is not None:
        settings = settings.model_copy(update={"backups": str(backups.resolve())})
    if not settings.data.is_dir():
        raise NotFound("there is no such data folder", got=str(settings.data), hint="set --data or GSS_DATA")
    services = build(settings)
    atexit.register(services.close_databases)
    return services


def parse_time(text: str) -> datetime:
    """Parse a time from the command line. Raises BadInput."""
    from gss.domain.errors import BadInput

    try:
        time = datetime.fromisoformat(text)
    except ValueError:
        raise BadInput("not a time", expected="2026-12-01T18:00:00Z", got=text) from None
    return time if time.tzinfo else time.replace(tzinfo=UTC)


def export_telemetry(arguments: argparse.Namespace) -> int:
    """Write the telemetry file, one block at a time."""
    from gss.domain.errors import BadInput
    from gss.operations.telemetry.telemetry_export import export

    services = services_of(arguments)
    if arguments.contact is not None:
        detail = services.contacts.contacts.detail(arguments.contact)
        start, end = detail.row.started, detail.end
    elif arguments.start and arguments.end:
        start, end = parse_time(arguments.start), parse_time(arguments.end)
    else:
        raise BadInput("no time range given", expected="--from and --to, or --contact")
    keys = [key.strip() for key in arguments.fields.split(",") if key.strip()]
    pieces = export(
        services.telemetry.telemetry.archive, keys, start, end, form=arguments.form, file_format=arguments.format
    )
    if arguments.out is None:
        sys.stdout.buffer.writelines(pieces)
        sys.stdout.buffer.flush()
    else:
        print(f"{arguments.out}: {write_pieces(arguments.out, pieces)} bytes", file=sys.stderr)
    return 0


def export_report(arguments: argparse.Namespace) -> int:
    """Write the pass report."""
    from gss.api.present.contact_sheet import contact_sheet
    from gss.api.present.contacts import report
    from gss.operations.contacts.contact_report import contact_report
    from gss.operations.report.html import as_html
    from gss.operations.report.pdf import as_pdf

    services = services_of(arguments)
    contact = contact_report(
        services.contacts.contacts, services.telemetry.telemetry.archive, services.base.database, arguments.contact
    )
    procedures = services.procedures.runs.between(contact.detail.row.started, contact.detail.end)
    contact_data = report(contact, procedures, services.contacts.handover.of_contact(arguments.contact))
    if arguments.format == "pdf":
        data = as_pdf(contact_sheet(contact_data), contact_data.contact.ended or contact_data.contact.started)
    elif arguments.format == "html":
        data = as_html(contact_sheet(contact_data)).encode()
    else:
        data = (contact_data.model_dump_json(indent=1) + "\n").encode()
    if arguments.out is None:
        sys.stdout.buffer.write(data)
    else:
        write_whole(arguments.out, data)
    return 0


def check_record(arguments: argparse.Namespace) -> int:
    """Check the record and print the gaps."""
    from gss.api.present.contacts import record

    services = services_of(arguments)
    if arguments.contact is not None:
        ids = [arguments.contact]
    else:
        newest = [contact.id for contact, *_ in services.contacts.contacts.newest(1_000_000 if arguments.all else 1)]
        ids = sorted(newest)
    checks = [record(contact_id, services.contacts.contacts.record(contact_id)) for contact_id in ids]
    unexplained = sum(check.unexplained for check in checks)
    if arguments.json:
        facts = {
            "contacts": [check.model_dump(mode="json") for check in checks],
            "expected": sum(check.expected for check in checks),
            "held": sum(check.held for check in checks),
            "unexplained": unexplained,
        }
        print(json.dumps(facts))
    else:
        for check in checks:
            _print(check)
    return 1 if unexplained else 0


def _print(check: RecordOut) -> None:
    completeness = f"{check.held} of {check.expected} packets ({100 * check.share:.3f} %)"
    print(f"contact {check.contact_id}: {completeness}, {len(check.gaps)} gaps, {check.unexplained} without a cause")
    for gap in check.gaps:
        mark = "  " if gap.explained else "??"
        print(f"  {mark} {gap.start:%Y-%m-%d %H:%M:%S} – {gap.end:%H:%M:%S}  {gap.missing:4d} missing  {gap.cause}")
    for gap in check.late:
        print(f"     {gap.start:%Y-%m-%d %H:%M:%S} – {gap.end:%H:%M:%S}  {gap.cause}")
