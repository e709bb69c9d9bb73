"""Coming passes as an iCalendar file (RFC 5545), for the calendars of operators."""

from __future__ import annotations

import math
from collections.abc import Iterator
from datetime import UTC, datetime

from gss.operations.passes.pass_table import ComingPass, PassTable

MAX_LINE_LENGTH = 75
"""Maximum length of a content line in bytes (RFC 5545 §3.1)."""


def calendar(table: PassTable) -> str:
    """Return the passes of a table as the text of an iCalendar file."""
    lines = ["BEGIN:VCALENDAR", "VERSION:2.0", "PRODID:-//GSS//Passes//EN", "CALSCALE:GREGORIAN"]
    name = table.current.row.spacecraft if table.current else "Spacecraft"
    for coming in table.passes:
        lines += _event(name, coming, table.start)
    lines.append("END:VCALENDAR")
    return "".join(part + "\r\n" for line in lines for part in _folded(line))


def _event(name: str, coming: ComingPass, stamp: datetime) -> list[str]:
    orbit_pass, station = coming.at, coming.station
    top_deg = math.degrees(orbit_pass.max_elevation_rad)
    description = (
        f"Rise {orbit_pass.rise:%H:%M:%S} UTC at azimuth {math.degrees(orbit_pass.rise_azimuth_rad):.0f}°, culmination "
        f"{orbit_pass.culmination:%H:%M:%S} UTC at {top_deg:.1f}°, set {orbit_pass.set:%H:%M:%S} UTC at azimuth "
        f"{math.degrees(orbit_pass.set_azimuth_rad):.0f}°. Sun {math.degrees(orbit_pass.sun_elevation_rad):.0f}° at the station."
    )
    return [
        "BEGIN:VEVENT",
        f"UID:pass-{station.id}-{orbit_pass.culmination:%Y%m%dT%H%M}@gss",
        f"DTSTAMP:{_utc(stamp)}",
        f"DTSTART:{_utc(orbit_pass.rise)}",
        f"DTEND:{_utc(orbit_pass.set)}",
        f"SUMMARY:{_text(f'{name} over {station.name}, {top_deg:.0f}°')}",
        f"LOCATION:{_text(station.name)}",
        f"GEO:{math.degrees(station.latitude_rad):.6f};{math.degrees(station.longitude_rad):.6f}",
        f"DESCRIPTION:{_text(description)}",
        "END:VEVENT",
    ]


def _utc(moment: datetime) -> str:
    return f"{moment.astimezone(UTC):%Y%m%dT%H%M%SZ}"


def _text(text: str) -> str:
    """Escape a text value (RFC 5545 §3.3.11). Unprintable characters are replaced by spaces."""
    plain = "".join(c if c.isprintable() else " " for c in text)
    return plain.replace("\\", "\\\\").replace(";", "\\;").replace(",", "\\,")


def _folded(line: str) -> Iterator[str]:
    """Yield a line in parts of at most 75 bytes without splitting a character. Each part after the first begins with a space."""
    part, size = "", 0
    for character in line:
        width = len(character.encode())
        if size + width > MAX_LINE_LENGTH:
            yield part
            part, size = " ", 1
        part, size = part + character, size + width
    yield part
