"""``gss passes``: list coming passes, and manage the orbit and ground stations. The server can be running."""

from __future__ import annotations

import argparse
import getpass
import math
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from gss.cli.whole_files import write_whole

if TYPE_CHECKING:
    from gss.api.schemas.passes import MaskPoint, SpacecraftOut
    from gss.cli import Commands
    from gss.store.models import Station
    from gss.wiring.services import Services


def register(subparsers: Commands) -> None:
    """Add the commands."""
    subcommands = subparsers.add_parser("passes").add_subparsers(dest="kind", required=True, metavar="WHAT")
    parser = subcommands.add_parser("list", help="list the passes of the coming days")
    _with_span(parser, 3.0)
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    _with_data(parser).set_defaults(run=list_passes)
    parser = subcommands.add_parser("calendar", help="write the coming passes as an iCalendar file")
    _with_span(parser, 7.0)
    parser.add_argument("--out", type=Path, help="file to write; standard output without it")
    _with_data(parser).set_defaults(run=write_calendar)
    parser = subcommands.add_parser("orbit", help="print the active orbit, or import another orbit: TLE, OMM or OEM")
    parser.add_argument("file", type=Path, nargs="?", help="orbit file to import; - for standard input")
    parser.add_argument("--name", default="", help="name of the spacecraft (default: the name in the file)")
    parser.add_argument("--source", default="", help="origin of the orbit data")
    _with_data(parser).set_defaults(run=orbit)
    parser = subcommands.add_parser("stations", help="list the ground stations")
    _with_data(parser).set_defaults(run=list_stations)
    parser = subcommands.add_parser("add-station", help="add a ground station")
    parser.add_argument("name")
    parser.add_argument("--latitude-deg", type=float, required=True, help="geodetic, WGS-84, north positive")
    parser.add_argument("--longitude-deg", type=float, required=True, help="east positive")
    parser.add_argument("--height-m", type=float, default=0.0, help="above the ellipsoid (default 0)")
    parser.add_argument("--min-elevation-deg", type=float, default=5.0, help="default 5")
    parser.add_argument(
        "--mask", type=Path, metavar="FILE", help="horizon mask: one line 'azimuth, elevation' in degrees per point"
    )
    parser.add_argument("--line-url", default="", help="address of the line at this station")
    parser.add_argument(
        "--line-baud", type=int, default=0, help="rate of the line (default 0: rate reported by the unit)"
    )
    parser.add_argument("--note", default="")
    _with_data(parser).set_defaults(run=add_station)
    parser = subcommands.add_parser("delete-station", help="delete a ground station")
    parser.add_argument("name")
    _with_data(parser).set_defaults(run=delete_station)


def _with_data(parser: argparse.ArgumentParser) -> argparse.ArgumentParser:
    parser.add_argument("--data", type=Path, help="data folder (GSS_DATA)")
    return parser


def _with_span(parser: argparse.ArgumentParser, days: float) -> None:
    parser.add_argument("--days", type=float, default=days, help=f"days ahead, at most 14 (default {days:g})")
    parser.add_argument("--station", metavar="NAME", help="only this ground station")


def list_passes(arguments: argparse.Namespace) -> int:
    """Print the passes. Return the exit code 1 if passes cannot be calculated."""
    from gss.api.present.passes import passes

    services = _services(arguments)
    table = passes(services.passes.table.upcoming(arguments.days, _station_id(services, arguments.station)))
    if arguments.json:
        print(table.model_dump_json(indent=1))
        return 1 if table.problem else 0
    for warning in table.warnings:
        print(f"gss: {warning}", file=sys.stderr)
    if table.problem:
        print(f"gss: {table.problem}", file=sys.stderr)
        return 1
    print(f"{'rise, UTC':<20} {'set':<9} {'station':<24} {'max':>6} {'rise at':>8} {'set at':>7} {'sun':>5}  budget")
    for coming in table.passes:
        budget = "–" if coming.content_bytes is None else f"{coming.content_bytes / 1000:.0f} kB"
        print(
            f"{coming.rise:%Y-%m-%d %H:%M:%S}  {coming.set:%H:%M:%S}  {coming.station:<24} {coming.max_elevation_deg:5.1f}° "
            f"{coming.rise_azimuth_deg:7.0f}° {coming.set_azimuth_deg:6.0f}° {coming.sun_elevation_deg:4.0f}°  {budget}"
        )
    return 0


def write_calendar(arguments: argparse.Namespace) -> int:
    """Write the calendar."""
    from gss.operations.passes.pass_calendar import calendar

    services = _services(arguments)
    table = services.passes.table.upcoming(arguments.days, _station_id(services, arguments.station))
    if table.problem:
        print(f"gss: {table.problem}", file=sys.stderr)
        return 1
    data = calendar(table).encode()
    if arguments.out is None:
        sys.stdout.buffer.write(data)
    else:
        write_whole(arguments.out, data)
    return 0


def orbit(arguments: argparse.Namespace) -> int:
    """Print or import the orbit."""
    from gss.api.present.passes import spacecraft
    from gss.api.schemas.passes import OrbitIn
    from gss.operations.requests import request_from

    services = _services(arguments)
    if arguments.file is None:
        _print_orbit(spacecraft(services.passes.spacecraft.current()))
        return 0
    data = sys.stdin.buffer.read() if str(arguments.file) == "-" else arguments.file.read_bytes()
    values = {"text": data.decode("utf-8", "replace"), "name": arguments.name, "source": arguments.source}
    request = request_from(OrbitIn, values)
    current, parsed = services.passes.spacecraft.set(
        request.text, name=request.name, source=request.source, user=_user()
    )
    _record(
        services,
        "orbit_import",
        current.row.spacecraft,
        f"{parsed.source_format} of {current.row.epoch:%Y-%m-%dT%H:%M}",
    )
    _print_orbit(spacecraft(current))
    return 0


def list_stations(arguments: argparse.Namespace) -> int:
    """Print the ground stations."""
    for row in _services(arguments).passes.stations.list_all():
        position = (
            f"{math.degrees(row.latitude_rad):+9.4f}° {math.degrees(row.longitude_rad):+10.4f}° {row.height_m:6.0f} m"
        )
        visibility = f"above {math.degrees(row.min_elevation_rad):g}°, " + (
            f"mask of {len(row.mask)} points" if row.mask else "no mask"
        )
        print(f"{row.name:<24} {position}  {visibility}  {row.line_url}".rstrip())
    return 0


def add_station(arguments: argparse.Namespace) -> int:
    """Store a ground station."""
    from gss.api.routers.passes import described, station_of
    from gss.api.schemas.passes import StationIn
    from gss.operations.requests import request_from

    names = ("name", "latitude_deg", "longitude_deg", "height_m", "min_elevation_deg", "line_url", "line_baud", "note")
    values = {name: getattr(arguments, name) for name in names}
    mask = _mask(arguments.mask) if arguments.mask else []
    body = request_from(StationIn, values | {"mask": [point.model_dump() for point in mask]})
    services = _services(arguments)
    row = services.passes.stations.create(station_of(body), body.line_url, body.line_baud, body.note, user=_user())
    _record(services, "station_add", row.name, described(body))
    print(f"{row.name} is added")
    return 0


def delete_station(arguments: argparse.Namespace) -> int:
    """Delete a ground station."""
    services = _services(arguments)
    services.passes.stations.delete(_station(services, arguments.name).id, user=_user())
    _record(services, "station_delete", arguments.name)
    print(f"{arguments.name} is deleted")
    return 0


def _services(arguments: argparse.Namespace) -> Services:
    from gss.cli.records import services_of

    return services_of(arguments)


def _record(services: Services, action: str, target: str, detail: str = "") -> None:
    services.accounts.audit.record(_user(), f"shell.{action}", target, "done", detail, role="shell")


def _user() -> str:
    return f"shell:{getpass.getuser()}"[:60]


def _station_id(services: Services, name: str | None) -> int | None:
    return None if name is None else _station(services, name).id


def _station(services: Services, name: str) -> Station:
    from gss.domain.errors import NotFound

    row = next((row for row in services.passes.stations.list_all() if row.name == name), None)
    if row is None:
        raise NotFound("no such ground station", got=name, hint="run gss passes stations to list them")
    return row


def _mask(file: Path) -> list[MaskPoint]:
    """Return the points of a mask file, sorted by azimuth. Raises BadInput, which names the invalid line."""
    from gss.api.schemas.passes import MaskPoint
    from gss.domain.errors import BadInput
    from gss.operations.requests import request_from

    points = []
    for number, line in enumerate(file.read_text("utf-8", "replace").splitlines(), 1):
        fields = line.partition("#")[0].replace(",", " ").replace(";", " ").split()
        if not fields:
            continue
        try:
            azimuth_deg, elevation_deg = (float(field) for field in fields)
        except ValueError:
            raise BadInput(
                f"line {number} of the mask is not valid", expected="azimuth, elevation", got=line[:60]
            ) from None
        points.append(request_from(MaskPoint, {"azimuth_deg": azimuth_deg, "elevation_deg": elevation_deg}))
    return sorted(points, key=lambda point: point.azimuth_deg)


def _print_orbit(craft: SpacecraftOut) -> None:
    print(f"{craft.name}: {craft.advice}" if craft.name else craft.advice)
    if craft.orbit is not None:
        print(
            f"{craft.orbit.source_format}, epoch {craft.orbit.epoch:%Y-%m-%d %H:%M:%S} UTC, source {craft.orbit.source or '–'}"
        )
        print(craft.orbit.lines, end="")
