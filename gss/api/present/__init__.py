"""Convert rows and records to response models: the only place where radians become degrees and arcseconds."""

from gss.api.present import (
    alarms,
    authority,
    calibrations,
    catalogues,
    commands,
    contacts,
    frames,
    instruments,
    link,
    passes,
    procedures,
    records,
    schedule,
    tables,
    telemetry,
)

__all__ = [
    "alarms",
    "authority",
    "calibrations",
    "catalogues",
    "commands",
    "contacts",
    "frames",
    "instruments",
    "link",
    "passes",
    "procedures",
    "records",
    "schedule",
    "tables",
    "telemetry",
]
