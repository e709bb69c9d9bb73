"""Rows and records into what travels: the one place where radians become degrees and arcseconds."""

from gss.api.present import (
    alarms,
    authority,
    calibrations,
    catalogues,
    commands,
    contacts,
    frames,
    link,
    records,
    schedule,
    stacks,
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
    "link",
    "records",
    "schedule",
    "stacks",
    "tables",
    "telemetry",
]
