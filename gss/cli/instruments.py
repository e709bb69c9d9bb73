"""The registry of instruments for commands: shipped packages and those in the data folder."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from gss.domain.camera_profile import CameraProfile
    from gss.instruments.package import Instrument
    from gss.instruments.registry import Registry

CAMERA_HELP = "an instrument; gss instrument list"


def registry(data: Path | None = None) -> Registry:
    """Return the registry of a data folder; by default of GSS_DATA."""
    from gss.instruments.registry import Registry
    from gss.settings import Settings

    settings = Settings(data=data) if data else Settings()
    return Registry(settings.instruments_folder)


def camera(name: str | None) -> CameraProfile:
    """Return a camera by the name of its instrument; None: that of GSS_INSTRUMENT. Raises NotFound."""
    from gss.settings import Settings

    return registry().camera(Settings().instrument if name is None else name)


def add_option(parser: argparse.ArgumentParser) -> None:
    """Add ``--instrument``; :func:`chosen` returns the instrument."""
    parser.add_argument(
        "--instrument", metavar="NAME", help="an instrument; gss instrument list (default: GSS_INSTRUMENT)"
    )


def chosen(arguments: argparse.Namespace) -> Instrument:
    """Return the instrument of ``--instrument``, by default the configured one. Raises NotFound."""
    from gss.settings import Settings

    data: Path | None = getattr(arguments, "data", None)
    return registry(data).get(arguments.instrument or Settings().unit_instrument)
