"""HEALPix pixel centres, compared with astropy-healpix."""

import numpy as np
import pytest
from astropy_healpix import HEALPix

from gss.catalogue_tools.envelope.healpix import centres, pixel_area_sr
from gss.domain.angles import unit_from_ra_dec


@pytest.mark.parametrize("nside", [1, 2, 4, 16, 32])
def test_centres_agree_with_astropy_healpix(nside):
    """Every pixel centre, in ring order, agrees within rounding errors."""
    lon, lat = HEALPix(nside, order="ring").healpix_to_lonlat(np.arange(12 * nside**2))
    assert np.abs(centres(nside) - unit_from_ra_dec(lon.rad, lat.rad)).max() < 1e-14


def test_pixels_cover_the_sphere():
    """The number of pixels times their area is 4π."""
    assert len(centres(8)) * pixel_area_sr(8) == pytest.approx(4 * np.pi)
