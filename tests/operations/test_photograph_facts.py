"""Properties of photographs: optics in headers, raw files, and level and gain of the sky background."""

from __future__ import annotations

import io

import numpy as np
import pytest
from astropy.io import fits
from PIL import Image

from gss.domain.errors import BadInput
from gss.operations.frames.frame_files import read_frame
from gss.pipeline.calibration.sky_figures import sky_figures

PIXELS = np.random.default_rng(1).integers(0, 200, (60, 80), dtype=np.uint8)


def jpeg(tags: dict[int, object], model: str = "") -> bytes:
    """Return a picture with EXIF tags."""
    exif, file = Image.Exif(), io.BytesIO()
    if model:
        exif[0x0110] = model
    exif.get_ifd(0x8769).update(tags)
    Image.fromarray(PIXELS).save(file, "JPEG", exif=exif)
    return file.getvalue()


def test_optics_of_a_photograph_are_read() -> None:
    """Focal length, aperture, model and pixel size are read from EXIF. The pixel size is derived from the resolution in the
    focal plane."""
    data = jpeg({0x920A: 24.0, 0x829D: 1.4, 0xA20E: 2000.0, 0xA210: 3, 0xA002: 80, 0xA003: 60}, "Roof 5")
    source = read_frame(data, "a.jpg").source
    assert (source["focal_mm"], source["f_number"], source["pixel_um"], source["camera"]) == (
        "24",
        "1.4",
        "5",
        "Roof 5",
    )
    assert "original_px" not in source


def test_a_resized_photograph_states_no_pixel_size() -> None:
    """For a resized photograph the source states the original size and no pixel size."""
    source = read_frame(jpeg({0xA20E: 2000.0, 0xA210: 3, 0xA002: 800, 0xA003: 600}), "a.jpg").source
    assert source["original_px"] == "800 x 600"
    assert "pixel_um" not in source


def test_optics_of_a_fits_file_are_read() -> None:
    """The pixel size of a FITS file is read from its header. An implausible focal length is ignored."""
    hdu, file = fits.PrimaryHDU(PIXELS), io.BytesIO()
    hdu.header["XPIXSZ"], hdu.header["FOCALLEN"] = 3.76, 1e9
    hdu.writeto(file)
    source = read_frame(file.getvalue(), "a.fits").source
    assert source["pixel_um"] == "3.76"
    assert "focal_mm" not in source


@pytest.mark.parametrize("tag", [{0xC612: bytes((1, 4, 0, 0))}, {0xFE: 1}])
def test_a_raw_file_is_rejected(tag: dict[int, object]) -> None:
    """A raw file is rejected, because its first image is only a preview."""
    file = io.BytesIO()
    Image.fromarray(PIXELS).save(file, "TIFF", tiffinfo=tag)
    with pytest.raises(BadInput, match="raw file"):
        read_frame(file.getvalue(), "a.dng")


def test_the_gain_follows_from_skies_of_different_level() -> None:
    """From skies with different levels, the measured gain is within four standard deviations of the true gain. With one level or
    with non-linear files, no gain is measured."""
    rng = np.random.default_rng(4)
    skies = [rng.poisson(2.5 * level, (320, 320)) / 2.5 + rng.normal(100, 3, (320, 320)) for level in (50, 400, 900)]
    measured = sky_figures(skies, linear=True)
    assert abs(measured.gain_e_per_dn - 2.5) < 4 * measured.gain_sigma < 1
    assert abs(measured.level_dn - 150) < 4 * measured.level_sigma < 2
    assert abs(measured.excess_dn - 350) < measured.excess_sigma
    assert np.isnan(sky_figures(skies[:1], linear=True).gain_e_per_dn)
    assert np.isnan(sky_figures(skies, linear=False).gain_e_per_dn)
