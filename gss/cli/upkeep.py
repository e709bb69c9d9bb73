"""Maintenance commands: ``gss backup``, ``gss restore``, ``gss retention``, ``gss check store``."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from gss.cli import Commands
    from gss.operations.upkeep.check_store import StoreReport

    Kinds = argparse._SubParsersAction[argparse.ArgumentParser]

MARKS = {"ok": "ok", "note": "note", "error": "ERROR"}
Rows = Sequence[tuple[str, str, Callable[[Any], str]]]
"""(name, label, formatter of the value)."""


def _bytes(value: float | None) -> str:
    if value is None:
        return "too little data to forecast"
    unit, units = 0, ("B", "KiB", "MiB", "GiB", "TiB")
    while value >= 1024 and unit < len(units) - 1:
        value, unit = value / 1024, unit + 1
    return f"{value:.{0 if unit == 0 else 1}f} {units[unit]}"


def _age(value: float) -> str:
    return f"{value:g} days" if value else "kept indefinitely"


def _count(value: float) -> str:
    return f"{value:g}"


def _full(value: float | None) -> str:
    if value is None:
        return "cannot be predicted"
    return f"in {value:.{1 if value < 10 else 0}f} days" if value < 3650 else "in more than ten years"


_POLICY_ROWS: Rows = (
    ("frames_days", "pixels are deleted at the age of", _age),
    ("frames_gb", "maximum total size of pixels", lambda v: f"{v:g} GB" if v else "any size"),
    ("keep_frames", "number of newest frames that keep pixels", _count),
    ("telemetry_thin_days", "packets are thinned at the age of", _age),
    ("telemetry_days", "packets are deleted at the age of", _age),
    ("events_days", "events are deleted at the age of", _age),
    (
        "captures_mb",
        "maximum total size of raw captures",
        lambda v: f"{v:g} MB" if v else "value of GSS_CAPTURE_KEEP_MB",
    ),
    ("backups_keep", "number of newest backups to keep", lambda v: f"{v:g}" if v else "all"),
)
_FORECAST_ROWS: Rows = (
    ("database_bytes", "database", _bytes),
    ("frames_bytes", "frames", _bytes),
    ("captures_bytes", "raw captures", _bytes),
    ("backups_bytes", "backups", _bytes),
    ("bytes_now", "total size", _bytes),
    ("bytes_per_day", "growth per day", _bytes),
    ("free_bytes", "free on the disk", _bytes),
    ("full_in_days", "the disk is full", _full),
    ("next_removal", "next removal", lambda v: f"{v:%Y-%m-%d %H:%MZ}" if v else "none, nothing has expired"),
    ("removable_bytes", "expired pixels", _bytes),
)
_REMOVED_ROWS: Rows = (
    ("frames", "frames with removed pixels", _count),
    ("bytes", "removed from the disk", _bytes),
    ("packets", "removed packets", _count),
    ("thinned", "removed by thinning", _count),
    ("events", "removed events", _count),
)


def register(subparsers: Commands) -> None:
    """Add the commands."""
    parser = subparsers.add_parser(
        "backup",
        description="Copy a snapshot of the database and all files that it refers to. "
        "Files of earlier backups are not copied again.",
    )
    parser.add_argument("--data", type=Path, help="data folder (GSS_DATA)")
    parser.add_argument(
        "--to", type=Path, metavar="FOLDER", help="folder of the backups (GSS_BACKUPS; default: in the data folder)"
    )
    parser.add_argument(
        "--keep", type=int, default=0, metavar="N", help="then delete all but the N newest backups; 0: keep all"
    )
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.set_defaults(run=backup)
    parser = subparsers.add_parser(
        "restore",
        description="Verify the backup before the restore. Existing data are never overwritten. A PostgreSQL backup is "
        "restored into the empty database of GSS_DATABASE.",
    )
    parser.add_argument("backup", type=Path, help="folder or tar file of a backup")
    parser.add_argument("--into", type=Path, required=True, metavar="FOLDER", help="new or empty data folder")
    parser.set_defaults(run=restore)
    parser = subparsers.add_parser("retention")
    parser.add_argument("--data", type=Path, help="data folder (GSS_DATA)")
    parser.add_argument("--run", action="store_true", dest="now", help="delete now; the server must be stopped")
    parser.add_argument("--confirm", action="store_true", help="with --run: confirm an unusually large removal")
    parser.add_argument(
        "--confirm-clock", action="store_true", help="confirm that date and time of this machine are correct"
    )
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.set_defaults(run=retention)


def register_check(kinds: Kinds) -> None:
    """Add the command to ``gss check``."""
    parser = kinds.add_parser(
        "store",
        help="check the data folder for missing and damaged data",
        description="Check database, files, captures and audit log. "
        "Exit code 0: intact, possibly with notes; 1: data are missing or damaged.",
    )
    parser.add_argument("--data", type=Path, help="data folder (GSS_DATA)")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.set_defaults(run=check_store)


def backup(arguments: argparse.Namespace) -> int:
    """Create a backup and print its location."""
    from gss.cli.records import services_of
    from gss.operations.folder_lock import private_files

    with private_files():
        services = services_of(arguments, arguments.to)
        service = services.upkeep.backups
        manifest = service.make(_show_progress)
    removed = service.prune(arguments.keep, manifest.name) if arguments.keep else []
    doubt = services.base.trust.state().doubt
    if arguments.keep and doubt:
        print(f"Old backups were not removed: the server's clock is {doubt} (gss retention)", file=sys.stderr)
    services.base.database.close()
    if arguments.json:
        facts = {"name": manifest.name, "folder": str(service.folder / manifest.name), "bytes": manifest.total_bytes}
        print(json.dumps(facts | {"files": len(manifest.blobs), "removed": removed}))
    else:
        print(
            f"{service.folder / manifest.name}: {manifest.total_bytes} bytes, {len(manifest.blobs)} files beside the database"
        )
        for name in removed:
            print(f"Removed {name}")
    return 0


def restore(arguments: argparse.Namespace) -> int:
    """Verify a backup, restore it and print how to start the server."""
    from gss.domain.errors import BadInput, CorruptData
    from gss.operations.clock import utc_now
    from gss.operations.folder_lock import private_files
    from gss.operations.upkeep.restore import KEYS_ENDED
    from gss.operations.upkeep.restore import restore as restore_backup
    from gss.settings import Settings

    settings = Settings()
    try:
        with private_files():
            restored = restore_backup(
                arguments.backup.resolve(),
                arguments.into,
                utc_now,
                database_url=settings.database,
                blobs_url=settings.blobs,
                audit_anchor=Path(settings.audit_anchor) if settings.audit_anchor else None,
                on_step=lambda text: print(f"… {text}", file=sys.stderr, flush=True) if sys.stderr.isatty() else None,
            )
    except CorruptData as error:  # a damaged backup is bad input of this command
        raise BadInput(error.message, expected=error.expected, got=error.got, hint=error.hint) from error
    print(
        f"{restored.folder}: backup {restored.manifest.name} of GSS {restored.manifest.version}, {restored.files} files"
    )
    print(KEYS_ENDED)
    print(f"Start it with: gss serve --data {restored.folder}")
    return 0


def retention(arguments: argparse.Namespace) -> int:
    """Print the retention policy and the forecast. Delete expired data if requested."""
    from dataclasses import asdict

    from gss.cli.records import services_of
    from gss.operations.folder_lock import folder_lock
    from gss.operations.upkeep.removal import confirmation

    services = services_of(arguments)
    if arguments.confirm_clock:
        services.base.trust.confirm(services.base.trust.state().now, user="the shell")
    clock, waiting = services.base.trust.state(), services.upkeep.retention.waiting()
    policy, forecast = services.upkeep.retention.policy(), services.upkeep.forecast.now()
    removal, failed = services.upkeep.retention.preview(policy), 0
    outcome: dict[str, str] = {}
    facts = {
        "policy": policy.model_dump(),
        "forecast": asdict(forecast),
        "clock": asdict(clock),
        "preview": asdict(removal),
    }
    if arguments.now:
        with folder_lock(services.base.settings.data):
            confirmed = confirmation(removal) if arguments.confirm else None
            job = services.upkeep.retention.run(user="the shell", confirmed=confirmed)
            services.base.jobs.finish()
            job = services.base.jobs.get(job.id)
            facts["removed"], outcome["state"] = job.result.get("removed", {}), job.state
            if job.state != "done":
                failed = 1
                print(f"gss: the removal is {job.state}: {job.text}", file=sys.stderr)
    services.base.database.close()
    if arguments.json:
        print(json.dumps(facts | outcome, default=str))
        return failed
    _print_rows(_POLICY_ROWS, facts["policy"])
    _print_rows(_FORECAST_ROWS, facts["forecast"])
    if clock.doubt:
        print(
            f"The clock is {clock.doubt}: nothing is deleted. Check date and time, then run: gss retention --confirm-clock"
        )
    if removal.unusual or waiting:
        print(
            f"A removal needs confirmation. It would delete {removal.unusual or waiting}. Check it, then use --run --confirm."
        )
    if arguments.now:
        _print_rows(_REMOVED_ROWS, facts["removed"])
    return failed


def check_store(arguments: argparse.Namespace) -> int:
    """Check the store and print the findings. The database is never migrated, because a damaged database must stay
    unchanged."""
    from gss.domain.errors import NotFound
    from gss.operations.accounts.audit import AuditService
    from gss.operations.accounts.audit_anchor import AnchorFile
    from gss.operations.clock import utc_now
    from gss.operations.upkeep.check_store import check_store as check
    from gss.settings import Settings
    from gss.store.blobs import BlobStore
    from gss.store.engine import Database, open_to_check

    settings = Settings(**({"data": arguments.data} if arguments.data else {}))
    if not settings.data.is_dir():
        raise NotFound("there is no such data folder", got=str(settings.data), hint="set --data or GSS_DATA")
    database = Database(open_to_check(settings.database_url))
    try:
        audit = AuditService(database, utc_now, AnchorFile(settings.audit_anchor_file))
        report = check(database, BlobStore(settings.blobs_url), settings.data / "captures", audit, _show_progress)
    finally:
        database.close()
    if arguments.json:
        print(json.dumps(report.plain()))
    else:
        _print(report)
    return 0 if report.whole else 1


def _print_rows(rows: Rows, values: Mapping[str, Any]) -> None:
    for name, label, write in rows:
        if name in values:
            print(f"{label:37} {write(values[name])}")


def _print(report: StoreReport) -> None:
    for finding in report.findings:
        print(f"{MARKS[finding.state]:5} {finding.name:20} {finding.text}")
        for example in finding.examples:
            print(f"{'':6} {'':20} {example}")
    print("The store is intact." if report.whole else "The store is NOT intact. Restore missing data from a backup.")


def _show_progress(done: int, total: int, text: str) -> None:
    if sys.stderr.isatty():
        print(f"\r… {text[:70]:70}", end="", file=sys.stderr, flush=True)
