"""``gss heads``: manage and list spacecraft with several heads. A running server applies the changes."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from gss.api.schemas.heads import HeadsOut
    from gss.cli import Commands
    from gss.operations.heads.mountings import SpacecraftSetup
    from gss.wiring.services import Services

LIMITS = ("largest_rate_deg_s", "misalignment_limit_arcsec", "drift_limit_arcsec_h")


def register(subparsers: Commands) -> None:
    """Add the commands."""
    kinds = subparsers.add_parser("heads").add_subparsers(dest="kind", required=True, metavar="WHAT")
    parser = kinds.add_parser("list", help="list the spacecraft with their latest comparison of heads")
    parser.add_argument("--json", action="store_true", help="print JSON")
    _with_data(parser).set_defaults(run=list_spacecraft)
    parser = kinds.add_parser("set", help="store a spacecraft with the mountings of its heads, or replace it")
    parser.add_argument("name")
    parser.add_argument(
        "--head",
        action="append",
        required=True,
        metavar="UNIT=X,Y,Z[@SIGMA]",
        help="unit and its mounting: rotations in degrees about x, then y, then z from the body's axes to the camera's axes, and "
        "the uncertainty of the mounting in arcseconds; the first head is the reference",
    )
    parser.add_argument("--source", choices=("on-board", "ground"), default="on-board", help="attitudes to compare")
    parser.add_argument(
        "--tolerance-s", type=float, default=1.0, help="largest time difference of compared attitudes (default 1)"
    )
    parser.add_argument(
        "--stale-s",
        type=float,
        default=30.0,
        help="time without attitudes after which a head counts as silent (default 30)",
    )
    parser.add_argument("--largest-rate-deg-s", type=float, help="largest rate of the body (default: not stated)")
    parser.add_argument(
        "--misalignment-limit-arcsec", type=float, help="raise an alarm above this value (default: none)"
    )
    parser.add_argument("--drift-limit-arcsec-h", type=float, help="raise an alarm above this value (default: none)")
    _with_data(parser).set_defaults(run=set_spacecraft)
    parser = kinds.add_parser("export", help="write the fused attitudes of the body as a CCSDS AEM or ACM")
    parser.add_argument("name")
    parser.add_argument("--from", dest="start", metavar="TIME", required=True, help="start, ISO 8601, UTC by default")
    parser.add_argument("--to", dest="end", metavar="TIME", required=True, help="end, ISO 8601")
    parser.add_argument("--format", default="aem", choices=("aem", "acm"), help="default aem; acm includes variances")
    _with_data(parser).set_defaults(run=export_fused)
    parser = kinds.add_parser("remove", help="delete a spacecraft with the history of its heads")
    parser.add_argument("name")
    _with_data(parser).set_defaults(run=remove_spacecraft)


def _with_data(parser: argparse.ArgumentParser) -> argparse.ArgumentParser:
    parser.add_argument("--data", type=Path, help="data folder (GSS_DATA)")
    return parser


def list_spacecraft(arguments: argparse.Namespace) -> int:
    """Print the spacecraft with their stored comparisons."""
    from pydantic import TypeAdapter

    from gss.api.schemas.heads import HeadsOut

    services = _services(arguments)
    stored = [_stored(services, setup) for setup in services.heads.book.list_all()]
    if arguments.json:
        print(TypeAdapter(list[HeadsOut]).dump_json(stored, indent=1).decode())
        return 0
    for spacecraft in stored:
        _print(spacecraft)
    return 0


def set_spacecraft(arguments: argparse.Namespace) -> int:
    """Store a spacecraft."""
    from gss.operations.heads.mountings import SpacecraftRequest
    from gss.operations.requests import request_from

    values = {name: getattr(arguments, name) for name in ("name", "tolerance_s", "stale_s", *LIMITS)}
    values |= {"source": arguments.source.replace("-", " "), "heads": [_head(text) for text in arguments.head]}
    request = request_from(SpacecraftRequest, values)
    services = _services(arguments)
    id_by_name = {stored.name: stored.id for stored in services.heads.book.list_all()}
    if request.name in id_by_name:
        setup = services.heads.book.change(id_by_name[request.name], request, user=_user())
    else:
        setup = services.heads.book.create(request, user=_user())
    _record(services, "heads_set", setup.name, ", ".join(arguments.head))
    print(f"{setup.name} is stored with {', '.join(head.unit for head in setup.heads)}")
    return 0


def export_fused(arguments: argparse.Namespace) -> int:
    """Print the fused attitudes of a spacecraft as a CCSDS message."""
    from gss.cli.records import parse_time

    services = _services(arguments)
    setup = services.heads.book.named(arguments.name)
    start, end = parse_time(arguments.start), parse_time(arguments.end)
    for line in services.heads.history.message(arguments.format, setup.id, start, end):
        print(line, end="")
    return 0


def remove_spacecraft(arguments: argparse.Namespace) -> int:
    """Delete a spacecraft."""
    services = _services(arguments)
    setup = services.heads.book.named(arguments.name)
    services.heads.book.remove(setup.id, user=_user())
    _record(services, "heads_remove", setup.name, "")
    print(f"{setup.name} is deleted")
    return 0


def _head(text: str) -> dict[str, object]:
    """Return the request of one head. Raises BadInput."""
    from gss.domain.errors import BadInput

    unit, _, mounting = text.partition("=")
    angles, _, sigma = mounting.partition("@")
    try:
        rotations_deg, sigma_arcsec = [float(part) for part in angles.split(",")], float(sigma or 0)
    except ValueError:
        raise BadInput("unreadable head", expected="UNIT=X,Y,Z or UNIT=X,Y,Z@SIGMA", got=text[:80]) from None
    return {"unit": unit, "mounting_deg": rotations_deg, "sigma_arcsec": sigma_arcsec}


def _stored(services: Services, setup: SpacecraftSetup) -> HeadsOut:
    """Return a spacecraft with its latest stored comparison."""
    from gss.api.present.heads import heads, stored_fused, stored_pair

    alarms = [view for view in services.telemetry.alarms.newest(1000) if view.row.closed is None]
    fused, pairs = services.heads.history.newest(setup)
    text = (
        "No comparison is stored." if fused is None else f"Latest stored comparison: {fused.at:%Y-%m-%d %H:%M:%S} UTC."
    )
    text = setup.problem or text
    return heads(setup, None, [head.unit for head in setup.heads], alarms).model_copy(
        update={
            "text": text,
            "fused": None if fused is None else stored_fused(fused),
            "pairs": [stored_pair(pair) for pair in pairs],
        }
    )


def _print(state: HeadsOut) -> None:
    print(f"{state.name}: attitudes {state.source}. {state.text}")
    for head in state.heads:
        x, y, z = head.mounting_deg
        print(f"  {head.unit:<24} mounting {x:.4f}° {y:.4f}° {z:.4f}° ± {head.sigma_arcsec:g}″")
    if state.fused is not None:
        chi2 = "one head" if state.fused.chi2 is None else f"χ² {state.fused.chi2:.1f} of {state.fused.freedom}"
        sigma = " ".join(f"{s:.1f}″" for s in state.fused.sigma_arcsec)
        print(
            f"  fused {state.fused.ra_deg:.4f}° {state.fused.dec_deg:+.4f}° {state.fused.roll_deg:.4f}° ± {sigma}, {chi2}"
        )
    for pair in state.pairs:
        for quantity, values, sigmas, unit in (
            ("misalignment", pair.misalignment_arcsec, pair.misalignment_sigma_arcsec, "″"),
            ("drift", pair.drift_arcsec_h, pair.drift_sigma_arcsec_h, "″/h"),
        ):
            figures = ", ".join(f"{v:+.1f} ± {s:.1f}{unit}" for v, s in zip(values, sigmas, strict=True))
            print(f"  {pair.unit} against {pair.reference}: {quantity} {figures}")
    for alarm in state.alarms:
        print(f"  alarm {alarm.level}, {alarm.state}: {alarm.text}")


def _services(arguments: argparse.Namespace) -> Services:
    from gss.cli.records import services_of

    return services_of(arguments)


def _record(services: Services, action: str, target: str, detail: str) -> None:
    services.accounts.audit.record(_user(), f"shell.{action}", target, "done", detail, role="shell")


def _user() -> str:
    import getpass

    return f"shell:{getpass.getuser()}"[:60]
