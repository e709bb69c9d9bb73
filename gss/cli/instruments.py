"""Registry of instruments for commands: shipped packages and packages in the data folder."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from gss.domain.camera_profile import CameraProfile
    from gss.instruments.package import Instrument
    from gss.instruments.registry import Registry

CAMERA_HELP = "instrument name; see gss instrument list"


def registry(data: Path | None = None) -> Registry:
    """Return the registry of a data folder. None: folder of GSS_DATA."""
    from gss.instruments.registry import Registry
    from gss.settings import Settings

    settings = Settings(data=data) if data else Settings()
    return Registry(settings.instruments_folder)


def camera(name: str | None) -> CameraProfile:
    """Return the camera of an instrument. ``name`` None: instrument of GSS_INSTRUMENT. Raises NotFound."""
    from gss.settings import Settings

    return registry().camera(Settings().instrument if name is None else name)


def add_option(parser: argparse.ArgumentParser) -> None:
    """Add ``--instrument``; :func:`chosen` returns the instrument."""
    parser.add_argument(
        "--instrument", metavar="NAME", help="instrument name; see gss instrument list (default: GSS_INSTRUMENT)"
    )


def chosen(arguments: argparse.Namespace) -> Instrument:
    """Return the instrument of ``--instrument``, by default the configured instrument. Raises NotFound."""
    from gss.settings import Settings

    data: Path | None = getattr(arguments, "data", None)
    return registry(data).get(arguments.instrument or Settings().unit_instrument)
