"""``gss instrument``: list, show, check, copy, add, export and compare instrument packages."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import TYPE_CHECKING

from gss.cli import new_instrument
from gss.cli.instruments import registry
from gss.cli.whole_files import write_whole
from gss.domain.errors import BadInput

if TYPE_CHECKING:
    from gss.cli import Commands
    from gss.instruments.package import Instrument


def register(subparsers: Commands) -> None:
    """Add the command."""
    parser = subparsers.add_parser("instrument", description="A package is a folder or a .zip of YAML files.")
    subcommands = parser.add_subparsers(dest="kind", required=True, metavar="COMMAND")
    listed = subcommands.add_parser("list", help="list the shipped instruments and those in the data folder")
    listed.add_argument("--json", action="store_true", help="print one JSON array")
    listed.set_defaults(run=run_list)
    show = subcommands.add_parser("show", help="print one instrument as JSON")
    show.add_argument("name", metavar="NAME")
    show.set_defaults(run=run_show)
    check = subcommands.add_parser("check", help="check a package; exit code 2 if it has mistakes")
    check.add_argument("path", type=Path, metavar="PATH")
    check.set_defaults(run=run_check)
    new = subcommands.add_parser(
        "new", help="write a package folder, copied from another instrument or created from photographs"
    )
    new_instrument.add_arguments(new)
    new.set_defaults(run=run_new)
    add = subcommands.add_parser("add", help="install a package in the data folder")
    add.add_argument("path", type=Path, metavar="PATH")
    add.set_defaults(run=run_add)
    export = subcommands.add_parser("export", help="write a package as a .zip file")
    export.add_argument("name", metavar="NAME")
    export.add_argument("--out", type=Path, metavar="FILE", help="default: NAME.zip")
    export.add_argument("--xtce", action="store_true", help="write the dictionary as XTCE (dictionary.xml)")
    export.set_defaults(run=run_export)
    diff = subcommands.add_parser("diff", help="compare the files of two instruments or packages")
    diff.add_argument("old", metavar="A")
    diff.add_argument("new", metavar="B")
    diff.set_defaults(run=run_diff)
    for p in (listed, show, add, new, export, diff):
        p.add_argument("--data", type=Path, help="folder of the store (GSS_DATA)")


def facts_of(instrument: Instrument) -> dict[str, object]:
    """Return the values that identify an instrument."""
    camera = instrument.profile.camera
    return {
        "name": instrument.name,
        "title": instrument.about.title,
        "version": instrument.version,
        "shipped": instrument.shipped,
        "columns": camera.columns,
        "rows": camera.rows,
        "focal_mm": instrument.profile.focal_mm,
        "chain": instrument.about.chain,
        "formats": list(instrument.profile.formats),
        "dictionary": instrument.dictionary.hash_hex,
    }


def run_list(arguments: argparse.Namespace) -> int:
    """Print the instruments. Invalid packages are listed with their errors."""
    instruments = registry(arguments.data)
    rows, broken = [facts_of(i) for i in instruments.all()], instruments.broken()
    if arguments.json:
        print(json.dumps([*rows, *({"name": b.name, "error": b.reason} for b in broken)]))
        return 0
    for row in rows:
        print(
            f"{row['name']:16} {str(row['version'])[:12]}  {'shipped' if row['shipped'] else 'own':7}  {row['title']}"
        )
    for b in broken:
        print(f"{b.name:16} invalid: {b.reason}")
    return 0


def run_show(arguments: argparse.Namespace) -> int:
    """Print an instrument."""
    instrument = registry(arguments.data).get(arguments.name)
    facts = facts_of(instrument) | {"about": instrument.about.model_dump(), "link": instrument.link.model_dump()}
    facts |= {"sources": instrument.profile.sources, "procedures": sorted(instrument.procedures)}
    print(json.dumps(facts, indent=1))
    return 0


def run_check(arguments: argparse.Namespace) -> int:
    """Load a package. If it contains a mistake, the command ends with an error that states file, line and field."""
    from gss.instruments.package import load_instrument
    from gss.instruments.package_source import read_package_files

    instrument = load_instrument(read_package_files(arguments.path))
    print(f"{instrument.name}: valid, version {instrument.version[:12]}")
    return 0


def run_new(arguments: argparse.Namespace) -> int:
    """Copy an instrument under another name, or create one from photographs. The package is checked before it is
    written."""
    if arguments.photographs is not None:
        return new_instrument.run_photographs(arguments)
    if arguments.model is None:
        raise BadInput("no source of the package given", expected="--from INSTRUMENT or --from-frames FOLDER")
    from gss.instruments.package import load_instrument

    files = dict(registry(arguments.data).get(arguments.model).files)
    text = files["instrument.yaml"].decode()
    changed = {"id": arguments.name} | ({"title": json.dumps(arguments.title)} if arguments.title else {})
    lines = [
        f"{key}: {changed[key]}" if (key := line.partition(":")[0]) in changed else line for line in text.splitlines()
    ]
    files["instrument.yaml"] = ("\n".join(lines) + "\n").encode()
    load_instrument(files)
    folder = new_instrument.write_new(arguments.into / arguments.name, files)
    print(f"{folder}: copy of {arguments.model}; edit it, then: gss instrument check {folder}")
    return 0


def run_add(arguments: argparse.Namespace) -> int:
    """Check a package and install it."""
    from gss.instruments.package_source import read_package_files

    instrument = registry(arguments.data).add(read_package_files(arguments.path))
    print(f"{instrument.name}: installed, version {instrument.version[:12]}")
    return 0


def run_export(arguments: argparse.Namespace) -> int:
    """Write a package as a zip archive."""
    from gss.instruments.package_source import write_zip

    instrument = registry(arguments.data).get(arguments.name)
    out = arguments.out or Path(f"{instrument.name}.zip")
    files = _with_xtce(instrument) if arguments.xtce else instrument.files
    write_whole(out, write_zip(instrument.name, files))
    print(out)
    return 0


def _with_xtce(instrument: Instrument) -> dict[str, bytes]:
    """Return the files of a package in which the dictionary is replaced by ``dictionary.xml``, even if it is a shared
    dictionary. The new package is checked."""
    from gss.device.xtce import xtce_of
    from gss.instruments.package import OWN_DICTIONARY, XTCE_DICTIONARY, load_instrument

    files = {name: data for name, data in instrument.files.items() if name != OWN_DICTIONARY}
    files[XTCE_DICTIONARY] = xtce_of(instrument).encode()
    lines = files["instrument.yaml"].decode().splitlines(keepends=True)
    files["instrument.yaml"] = "".join(line for line in lines if not line.startswith("dictionary:")).encode()
    load_instrument(files)
    return files


def run_diff(arguments: argparse.Namespace) -> int:
    """Print the differences between the files. Return the exit code 0 if there are no differences, otherwise 1."""
    from gss.instruments.compare import compare

    old, new = (_files(name, arguments.data) for name in (arguments.old, arguments.new))
    lines = [line for file in compare(old, new, arguments.old, arguments.new) for line in file.lines]
    print("\n".join(lines) or "no differences")
    return int(bool(lines))


def _files(name: str, data: Path | None) -> dict[str, bytes]:
    """Return the files of an instrument (NAME or NAME@VERSION), a folder or a .zip file."""
    from gss.instruments.package_source import read_package_files

    instruments, (plain, _, version) = registry(data), name.partition("@")
    if plain in instruments.names():
        return dict(instruments.find(plain, version).files)
    return read_package_files(Path(name))
