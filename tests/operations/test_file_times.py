"""Times of observation in the headers of image files."""

from __future__ import annotations

import io
from datetime import UTC, datetime

import numpy as np
import pytest
from astropy.io import fits
from PIL import Image

from gss.operations.frames.frame_files import ImportedFrame, read_frame

PIXELS = np.random.default_rng(1).integers(0, 60, (32, 32), dtype=np.uint8)
FOCAL_LENGTH = {0x920A: 24.0}


def photograph(tags: dict[int, str], changed: str = "") -> ImportedFrame:
    """Return a JPEG file with EXIF tags, as it is read. ``changed``: time of the last change of the file."""
    exif, file = Image.Exif(), io.BytesIO()
    if changed:
        exif[0x0132] = changed
    exif.get_ifd(0x8769).update(tags | FOCAL_LENGTH)
    Image.fromarray(PIXELS).save(file, "JPEG", exif=exif)
    return read_frame(file.getvalue(), "a.jpg")


def fits_file(cards: dict[str, object]) -> ImportedFrame:
    """Return a FITS file with these cards, as it is read."""
    hdu, file = fits.PrimaryHDU(PIXELS), io.BytesIO()
    hdu.header.update(cards)
    hdu.writeto(file)
    return read_frame(file.getvalue(), "a.fits")


@pytest.mark.parametrize(
    ("tags", "expected"),
    [
        ({}, datetime(2026, 12, 1, 6, 30)),
        ({0x9011: "+09:00"}, datetime(2026, 11, 30, 21, 30)),
        ({0x9011: "-03:30", 0x9291: "90"}, datetime(2026, 12, 1, 10, 0, 0, 900_000)),
        ({0x9291: "004 "}, datetime(2026, 12, 1, 6, 30, 0, 4_000)),
        ({0x9291: "12345678"}, datetime(2026, 12, 1, 6, 30, 0, 123_456)),
        ({0x9011: "   :  ", 0x9291: "-1"}, datetime(2026, 12, 1, 6, 30)),
        ({0x9010: "+01:00", 0x9290: "5"}, datetime(2026, 12, 1, 6, 30)),
    ],
)
def test_the_time_of_a_photograph_has_its_offset_and_fraction(tags: dict[int, str], expected: datetime) -> None:
    """The offset from UTC and the fraction of the second of the original time are applied. Without them, the time is UTC."""
    frame = photograph({0x9003: "2026:12:01 06:30:00"} | tags)
    assert frame.taken_at == expected.replace(tzinfo=UTC)
    assert frame.source["focal_mm"] == "24"


def test_the_time_of_the_last_change_has_its_own_offset() -> None:
    """Without an original time, the time of the last change is used with its own offset and fraction."""
    frame = photograph({0x9011: "+09:00", 0x9010: "+01:00", 0x9290: "5"}, "2026:12:01 06:30:00")
    assert frame.taken_at == datetime(2026, 12, 1, 5, 30, 0, 500_000, tzinfo=UTC)


@pytest.mark.parametrize(
    "cards",
    [
        {"DATE-OBS": "2026-11-30", "TIME-OBS": "21:15:00.5"},
        {"DATE-OBS": "2026-11-30", "UT": " 21:15:00.500 "},
        {"DATE-OBS": "2026-11-30", "TIME-OBS": 21.25, "UT": "21:15:00.5"},
        {"DATE-OBS": "2026-11-30T21:15:00.5", "TIME-OBS": "09:00:00"},
        {"DATE-OBS": "2026-11-30T23:15:00.5+02:00"},
    ],
)
def test_the_time_of_a_fits_file_can_be_in_two_cards(cards: dict[str, object]) -> None:
    """If DATE-OBS is only a date, TIME-OBS or UT is the time."""
    assert fits_file(cards).taken_at == datetime(2026, 11, 30, 21, 15, 0, 500_000, tzinfo=UTC)


@pytest.mark.parametrize(
    ("scale", "time"),
    [
        ("UTC", "21:15:00.500"),
        ("utc(NIST)", "21:15:00.500"),
        (" ", "21:15:00.500"),
        ("GPS", "21:15:18.500"),
        ("TAI", "21:15:37.500"),
        ("TT(TAI)", "21:16:09.684"),
        ("ET", "21:16:09.684"),
        ("TDB", "21:16:09.683"),
        ("TCG", "21:16:10.782"),
        ("TCB", "21:16:34.106"),
    ],
)
def test_the_time_of_a_fits_file_is_in_its_scale(scale: str, time: str) -> None:
    """The scale TIMESYS is converted to UTC within a millisecond. The values are those of astropy."""
    taken = fits_file({"DATE-OBS": f"2026-11-30T{time}", "TIMESYS": scale}).taken_at
    assert taken is not None
    assert abs((taken - datetime(2026, 11, 30, 21, 15, 0, 500_000, tzinfo=UTC)).total_seconds()) < 1e-3


@pytest.mark.parametrize("scale", ["UT1", "LOCAL", "TBD", 5])
def test_a_time_in_an_unknown_scale_is_unknown(scale: str | int) -> None:
    """A time in a scale that cannot be converted is unknown. The texts of the header are kept."""
    frame = fits_file({"DATE-OBS": "2026-11-30T21:15:00", "TIMESYS": scale})
    assert frame.taken_at is None
    assert (frame.source["date-obs"], frame.source["timesys"]) == ("2026-11-30T21:15:00", str(scale))


@pytest.mark.parametrize("more", [{}, {"UT": "24:61:00"}, {"UT": "21"}, {"TIME-OBS": 21.25}])
def test_a_date_alone_is_an_unknown_time(more: dict[str, object]) -> None:
    """A date without a readable time is not midnight. The text of the header is kept."""
    frame = fits_file({"DATE-OBS": "2026-11-30"} | more)
    assert frame.taken_at is None
    assert frame.source["date-obs"] == "2026-11-30"
