"""Times of observation in the headers of image files."""

from __future__ import annotations

import re
from datetime import UTC, date, datetime
from typing import Any

FIRST_YEAR, LAST_YEAR = 1900, 2200
UTC_NAMES, TAI_NAMES, TT_NAMES = ("UTC", "UT", "GMT"), ("TAI", "IAT"), ("TT", "TDT", "ET")
GPS_BEHIND_TAI_S = 19.0
DIGITS, OFFSET = re.compile(r"[0-9]+"), re.compile(r"[+-](?:0[0-9]|1[0-4]):[0-5][0-9]")


def exif_time(exif: Any, inner: Any) -> datetime | None:
    """Return the UTC time at which a photograph was taken, None if it is not stated. A time without an offset is read as UTC.
    ``exif``, ``inner``: tags of the file and of its EXIF block. Raises ValueError if the time is unreadable or implausible."""
    original = inner.get(0x9003)
    text = original or exif.get(0x0132)
    if not isinstance(text, str):
        return None
    part, offset = (0x9291, 0x9011) if original else (0x9290, 0x9010)
    digits, zone = _matching(DIGITS, inner.get(part)) or "0", _matching(OFFSET, inner.get(offset)) or "+00:00"
    return _plausible(datetime.strptime(f"{_plain(text)}.{digits[:6]}{zone}", "%Y:%m:%d %H:%M:%S.%f%z"))


def fits_time(header: Any) -> datetime | None:
    """Return the UTC time of a FITS header: DATE-OBS, with TIME-OBS or UT if it is only a date, in the scale TIMESYS. None if no
    date is stated. Raises ValueError if the time is missing, unreadable or implausible, or its scale is unknown."""
    text = header.get("DATE-OBS")
    if not isinstance(text, str) or not text:
        return None
    text = text.strip()
    if _is_date(text):
        times = (header.get(key) for key in ("TIME-OBS", "UT"))
        text += "T" + next((time.strip() for time in times if isinstance(time, str) and ":" in time), "")
    when = datetime.fromisoformat(text)
    if when.tzinfo is None:
        # A realization may follow the scale, for example TT(TAI).
        when = _utc(when, str(header.get("TIMESYS", "UTC")).partition("(")[0].strip().upper() or "UTC")
    return _plausible(when)


def _utc(when: datetime, scale: str) -> datetime:
    """Convert a time to UTC from a scale of the FITS standard 4.0, table 30. Raises ValueError for UT1, whose difference from
    UTC is measured, and for local and unknown scales."""
    if scale in UTC_NAMES:
        return when.replace(tzinfo=UTC)
    import erfa  # type: ignore[import-untyped]  # the package has no types

    # The conversions do not use the scale's name here, except for UTC, whose days can have another length.
    moment = erfa.dtf2d(
        "", when.year, when.month, when.day, when.hour, when.minute, when.second + when.microsecond / 1e6
    )
    if scale == "GPS":
        moment = moment[0], moment[1] + GPS_BEHIND_TAI_S / erfa.DAYSEC
    elif scale not in TAI_NAMES:
        moment = erfa.tttai(*_terrestrial(moment, scale))
    year, month, day, (hour, minute, second, microsecond) = erfa.d2dtf("UTC", 6, *erfa.taiutc(*moment))
    return datetime(year, month, day, hour, minute, second, microsecond, UTC)


def _terrestrial(moment: tuple[float, float], scale: str) -> tuple[float, float]:
    """Convert a Julian date in two parts to TT from TT, TDB, TCG or TCB."""
    import erfa

    if scale == "TCB":
        moment, scale = erfa.tcbtdb(*moment), "TDB"
    if scale == "TDB":
        moment, scale = erfa.tdbtt(*moment, erfa.dtdb(*moment, 0.0, 0.0, 0.0, 0.0)), "TT"
    if scale == "TCG":
        moment, scale = erfa.tcgtt(*moment), "TT"
    if scale not in TT_NAMES:
        raise ValueError(f"unknown time scale {scale}")
    return moment


def _is_date(text: str) -> bool:
    try:
        date.fromisoformat(text)
    except ValueError:
        return False
    return True


def _plain(text: str) -> str:
    return text.strip("\0 ")


def _matching(pattern: re.Pattern[str], text: object) -> str:
    plain = _plain(text) if isinstance(text, str) else ""
    return plain if pattern.fullmatch(plain) else ""


def _plausible(moment: datetime) -> datetime:
    """Return the time in UTC if its year is plausible for a photograph. Raises ValueError otherwise, the same error as for an
    unreadable date."""
    if not FIRST_YEAR <= moment.year <= LAST_YEAR:
        raise ValueError(f"no photograph was taken in {moment.year}")
    return moment.astimezone(UTC)
