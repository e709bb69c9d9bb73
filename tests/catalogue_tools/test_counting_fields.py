"""The fast count of stars in many fields, compared with brute force."""

from concurrent.futures import ThreadPoolExecutor

import astropy.units as u
import numpy as np
import pytest
from astropy_healpix import HEALPix

from gss.catalogue_tools.envelope.envelope import WholeSky
from gss.catalogue_tools.envelope.field import CircularField, FieldShape
from gss.catalogue_tools.envelope.healpix import centres, pixel_of, pixel_radius_rad
from gss.catalogue_tools.selection.counting import Shadow, fields_per_star, stars_per_field
from gss.catalogue_tools.sources.hipparcos import load_stars
from gss.instruments.registry import shipped_camera, shipped_registry


def attitudes(count, seed=3):
    """Return random attitudes over the whole sky."""
    return WholeSky(FieldShape(shipped_camera("sunsat").camera)).attitudes(np.random.default_rng(seed), count)


@pytest.mark.parametrize("name", [i.name for i in shipped_registry().all() if i.profile.chain])
def test_counts_agree_with_brute_force(name):
    """For every camera, the counts equal a test of each star in each field."""
    shape, unit, cam = FieldShape(shipped_camera(name).camera), load_stars(5.0).icrs, attitudes(3000)
    counts = stars_per_field(unit, cam, shape)
    assert np.array_equal(counts[:400], [shape.inside(unit @ a.T).sum() for a in cam[:400]])
    assert counts.sum() > 0


@pytest.mark.parametrize("radius", [0.001, 0.3, 1.7, 3.1])
def test_circles_of_any_size_are_counted(radius):
    """Stars in circles are counted, also in circles larger than half the sky."""
    unit, cam = load_stars(4.0).icrs, attitudes(500)
    disc = CircularField(radius)
    assert np.array_equal(stars_per_field(unit, cam, disc), [disc.inside(unit @ a.T).sum() for a in cam])


def test_threads_give_the_same_counts():
    """A pool of threads gives the same counts in the same order."""
    shape, unit, cam = FieldShape(shipped_camera("cubestar").camera), load_stars(4.0).icrs, attitudes(60_000)
    with ThreadPoolExecutor(2) as pool:
        assert np.array_equal(stars_per_field(unit, cam, shape), stars_per_field(unit, cam, shape, pool.map))


def test_both_counts_agree():
    """Stars per field and fields per star have the same sum, also with occultation, which only removes pairs."""
    shape, unit, cam = FieldShape(shipped_camera("cubestar").camera), load_stars(4.0).icrs, attitudes(4000)
    nadir = attitudes(4000, 9)[:, 0]
    shadow = Shadow(nadir, 1.2)
    unshaded, shaded = stars_per_field(unit, cam, shape), stars_per_field(unit, cam, shape, shadow=shadow)
    assert fields_per_star(unit, cam, shape).sum() == unshaded.sum()
    assert fields_per_star(unit, cam, shape, shadow).sum() == shaded.sum()
    assert np.all(shaded <= unshaded)
    not_occulted = unit @ nadir[7] <= np.cos(1.2)
    assert shaded[7] == shape.inside(unit[not_occulted] @ cam[7].T).sum()


def test_no_stars_or_no_fields_give_zero():
    """Without stars the counts are zero. Without fields the list is empty."""
    shape = FieldShape(shipped_camera("cubestar").camera)
    assert stars_per_field(np.empty((0, 3)), attitudes(3), shape).tolist() == [0, 0, 0]
    assert len(stars_per_field(centres(2), attitudes(0), shape)) == 0


@pytest.mark.parametrize("nside", [1, 3, 8, 64])
def test_healpix_numbers_and_radius_are_correct(nside):
    """HEALPix numbers of random directions equal astropy-healpix's. No direction is farther from the centre of its
    pixel than the stated radius.
    """
    unit = attitudes(20_000)[:, 0]
    pixels = pixel_of(nside, unit)
    lon, lat = np.arctan2(unit[:, 1], unit[:, 0]), np.arcsin(unit[:, 2])
    assert np.array_equal(pixels, HEALPix(nside).lonlat_to_healpix(lon * u.rad, lat * u.rad))
    distance_rad = np.arccos(np.clip(np.einsum("ij,ij->i", centres(nside)[pixels], unit), -1, 1))
    assert distance_rad.max() <= pixel_radius_rad(nside)
    assert np.array_equal(pixel_of(nside, centres(nside)), np.arange(12 * nside**2))
