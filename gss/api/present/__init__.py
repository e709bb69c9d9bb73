"""Rows and records into what travels: the one place where radians become degrees and arcseconds."""

from gss.api.present import catalogues, commands, frames, link, records, telemetry

__all__ = ["catalogues", "commands", "frames", "link", "records", "telemetry"]
