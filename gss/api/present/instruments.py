"""Instrument packages as responses."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gss.api.schemas.instruments import (
    BrokenPackageOut,
    CameraNumberOut,
    DictionarySummaryOut,
    FileDifferenceOut,
    InstrumentDetailOut,
    InstrumentOut,
    InstrumentsOut,
    PackageCheckOut,
    ProcedureOut,
    UseOut,
)
from gss.instruments.package import Instrument
from gss.operations.instruments.packages import Installed, InstrumentService, PackageReport


def instruments(service: InstrumentService) -> InstrumentsOut:
    """Return all instruments as a list."""
    return InstrumentsOut(
        unit=service.unit.name,
        instruments=[instrument(i) for i in service.all()],
        broken=[BrokenPackageOut.model_validate(b) for b in service.broken()],
    )


def instrument(installed: Installed) -> InstrumentOut:
    """Return an instrument as a list entry."""
    about, i = installed.instrument.about, installed.instrument
    return InstrumentOut(
        name=i.name,
        title=about.title,
        maker=about.maker,
        release=about.version,
        version=i.version,
        origin="shipped" if i.shipped else "own",
        configured=installed.configured,
        connected=installed.connected,
        in_use=installed.in_use,
        use=UseOut.model_validate(installed.total),
    )


def instrument_detail(installed: Installed, versions: Sequence[str]) -> InstrumentDetailOut:
    """Return the complete content of a package."""
    i = installed.instrument
    camera, definitions = i.profile.camera, i.dictionary
    return InstrumentDetailOut(
        **dict(instrument(installed)),
        versions=list(versions),
        uses=[UseOut.model_validate(use) for use in installed.uses],
        references=list(i.about.references),
        notes=i.about.notes,
        tried_on_hardware=i.about.tried_on_hardware,
        driver=i.about.driver,
        chain=i.about.chain or "",
        mounting=i.about.mounting,
        numbers=[CameraNumberOut.model_validate(number) for number in i.camera.numbers()],
        field_of_view_deg=(
            float(np.degrees(camera.fov_rad[0])),
            float(np.degrees(camera.fov_rad[1])),
        ),
        link=i.link,
        catalogue=i.catalogue,
        simulator=i.simulator,
        dictionary=DictionarySummaryOut(
            shared=i.about.dictionary,
            hash=definitions.hash_hex,
            commands=len(definitions.commands),
            packets=len(definitions.telemetry),
            events=len(definitions.events),
        ),
        procedures=procedures(i),
        files=sorted(i.files),
    )


def procedures(instrument: Instrument) -> list[ProcedureOut]:
    """Return the procedures of a package, sorted by file name. The title is the first heading."""
    return [ProcedureOut(file=file, title=title_of(text, file)) for file, text in sorted(instrument.procedures.items())]


def title_of(text: str, file: str) -> str:
    """Return the first heading of a Markdown text, else the file's name."""
    line = next((line for line in text.splitlines() if line.startswith("# ")), f"# {file.removesuffix('.md')}")
    return line.removeprefix("# ").strip()


def package_check(report: PackageReport) -> PackageCheckOut:
    """Return the result of checking a package."""
    checked = report.checked
    return PackageCheckOut(
        valid=checked is not None,
        name=checked.name if checked else "",
        title=checked.title if checked else "",
        version=checked.version if checked else "",
        problems=list(report.problems),
        replaces=report.replaces,
        differences=[FileDifferenceOut.model_validate(d) for d in report.differences],
    )
