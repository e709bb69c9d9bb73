"""Image files become frames, or an error that states the reason."""

from __future__ import annotations

import io
import struct
import zlib
from datetime import UTC, datetime

import numpy as np
import pytest
from astropy.io import fits
from PIL import Image

from gss.domain.errors import BadInput
from gss.operations.frames.frame_files import read_frame

RNG = np.random.default_rng(1)
GREY8 = RNG.integers(0, 256, (40, 60), dtype=np.uint8)
GREY16 = RNG.integers(0, 65536, (40, 60), dtype=np.uint16)


def fits_bytes(array: np.ndarray, **header: object) -> bytes:
    hdu = fits.PrimaryHDU(array)
    hdu.header.update(header)
    out = io.BytesIO()
    hdu.writeto(out)
    return out.getvalue()


def picture(array: np.ndarray, kind: str, **options: object) -> bytes:
    out = io.BytesIO()
    Image.fromarray(array).save(out, kind, **options)
    return out.getvalue()


@pytest.mark.parametrize("kind", ["PNG", "TIFF"])
@pytest.mark.parametrize("array", [GREY8, GREY16], ids=["8 bit", "16 bit"])
def test_lossless_pictures_keep_every_value(kind: str, array: np.ndarray) -> None:
    """PNG and TIFF of 8 and 16 bits are read exactly, regardless of the file name."""
    frame = read_frame(picture(array, kind), "holiday.jpg")
    assert frame.pixels.dtype == array.dtype
    assert (frame.pixels == array).all()
    assert frame.bits == array.dtype.itemsize * 8


def test_colour_becomes_luminance() -> None:
    """RGB and RGBA are weighted 0.299, 0.587, 0.114; transparency is ignored."""
    rgb = RNG.integers(0, 256, (20, 30, 3), dtype=np.uint8)
    expected = np.rint(rgb @ [0.299, 0.587, 0.114])
    rgba = np.dstack([rgb, np.zeros((20, 30), np.uint8)])
    for array in (rgb, rgba):
        assert np.abs(read_frame(picture(array, "PNG"), "x").pixels - expected).max() <= 1


def test_jpeg_is_read() -> None:
    """A grey JPEG of high quality is read as 8 bits, within 4 DN of the original."""
    smooth = np.rint(np.linspace(0, 200, 60)[None] + np.zeros((40, 1))).astype(np.uint8)
    frame = read_frame(picture(smooth, "JPEG", quality=95), "x.fits")
    assert frame.pixels.dtype == np.uint8
    assert np.abs(frame.pixels.astype(int) - smooth).max() <= 4


@pytest.mark.parametrize("options", [{}, {"progressive": True}, {"optimize": True}, {"restart_marker_rows": 1}])
@pytest.mark.parametrize("bands", [1, 3])
def test_a_jpeg_header_that_states_more_rows_than_the_data_is_rejected(options: dict[str, object], bands: int) -> None:
    """A JPEG whose header states more rows than it has is rejected, because the decoder would invent pixels. The unchanged
    file is read."""
    shape = (64, 96) if bands == 1 else (64, 96, bands)
    data = picture(RNG.integers(0, 256, shape, dtype=np.uint8), "JPEG", **options)
    assert read_frame(data, "x.jpg").pixels.shape == (64, 96)
    position = next(k for k in range(2, len(data)) if data[k : k + 2] in (b"\xff\xc0", b"\xff\xc2")) + 5
    enlarged = data[:position] + (256).to_bytes(2, "big") + data[position + 2 :]
    with pytest.raises(BadInput, match="damaged"):
        read_frame(enlarged, "x.jpg")


@pytest.mark.parametrize("kind", ["u1", "i2", "u2", "i4", "f4", "f8", "i8"])
def test_every_fits_bitpix(kind: str) -> None:
    """All BITPIX of the standard are read in the right orientation with their values."""
    array = (np.arange(24 * 36).reshape(24, 36) % 200).astype(kind)
    frame = read_frame(fits_bytes(array), "a.fits")
    assert frame.pixels.dtype in (np.uint8, np.uint16, np.float32)
    assert (frame.pixels == array).all()


def test_fits_header_is_read() -> None:
    """Exposure, date and instrument are read from the header; scaling is applied; the first image extension is used."""
    data = fits_bytes(GREY16, EXPTIME=0.25, **{"DATE-OBS": "2024-03-05T21:10:11.5", "INSTRUME": "tracker"})
    frame = read_frame(data, "a")
    assert (frame.pixels == GREY16).all()
    assert frame.exposure_s == 0.25
    assert frame.taken_at == datetime(2024, 3, 5, 21, 10, 11, 500_000, tzinfo=UTC)
    assert frame.source["instrume"] == "tracker"
    out = io.BytesIO()
    table = fits.BinTableHDU.from_columns([fits.Column("a", "E", array=np.zeros(3))])
    fits.HDUList([fits.PrimaryHDU(), table, fits.ImageHDU(GREY8)]).writeto(out)
    assert (read_frame(out.getvalue(), "b").pixels == GREY8).all()


def bomb() -> bytes:
    """Return a PNG that declares 40 000 x 40 000 pixels."""

    def chunk(name: bytes, body: bytes) -> bytes:
        return struct.pack(">I", len(body)) + name + body + struct.pack(">I", zlib.crc32(name + body))

    head = struct.pack(">IIBBBBB", 40_000, 40_000, 8, 0, 0, 0, 0)
    return (
        b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", zlib.compress(b"\0" * 1000)) + chunk(b"IEND", b"")
    )


def huge_fits() -> bytes:
    """Return a FITS header that declares 30 000 x 30 000 pixels, without data."""
    cards = ["SIMPLE  =                    T", "BITPIX  =                   16", "NAXIS   =                    2"]
    cards += ["NAXIS1  =                30000", "NAXIS2  =                30000", "END"]
    return "".join(c.ljust(80) for c in cards).encode().ljust(2880)


NAN = np.zeros((20, 20), np.float32)
NAN[3, 4] = np.nan

BAD = {
    "empty file": b"",
    "text": b"just some words, no picture at all",
    "zip archive": b"PK\x03\x04" + bytes(100),
    "GIF": b"GIF89a" + bytes(100),
    "truncated PNG": picture(GREY8, "PNG")[:-700],
    "PNG signature only": b"\x89PNG\r\n\x1a\n",
    "truncated JPEG": picture(GREY8, "JPEG")[:300],
    "damaged TIFF": b"II*\0" + bytes(60),
    "truncated FITS": fits_bytes(GREY16)[:3000],
    "FITS without image": fits_bytes(None),  # type: ignore[arg-type]
    "FITS header cut": fits_bytes(GREY16)[:400],
    "some NaN": fits_bytes(NAN),
    "all NaN": fits_bytes(np.full((20, 20), np.nan, np.float32)),
    "infinite": fits_bytes(np.full((20, 20), np.inf, np.float64)),
    "one pixel": picture(GREY8[:1, :1], "PNG"),
    "thin strip": picture(GREY8[:3], "PNG"),
    "decompression bomb": bomb(),
    "too many FITS pixels": huge_fits(),
    "one axis": fits_bytes(np.zeros(100, np.float32)),
}


@pytest.mark.parametrize("what", BAD)
def test_unusable_files_are_rejected_with_a_reason(what: str) -> None:
    """Each damaged, empty, foreign, absurd or huge file is BadInput with its name, the expected and the actual content."""
    with pytest.raises(BadInput) as caught:
        read_frame(BAD[what], "night.png")
    assert "night.png" in caught.value.message
    assert caught.value.expected
    assert caught.value.got
    assert "\n" not in str(caught.value)


def test_any_truncation_is_rejected_or_complete() -> None:
    """A PNG truncated at any length is rejected or decoded completely, never to a partly empty frame."""
    complete_file = picture(GREY8, "PNG")
    for length in range(0, len(complete_file), 37):
        try:
            assert (read_frame(complete_file[:length], "x").pixels == GREY8).all()
        except BadInput:
            continue
