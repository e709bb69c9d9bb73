"""Tables of a format that are computed from its stars: k-vector, reduced catalogue, triplets, links."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from gss.catalogue_tools.envelope.field import FieldShape
from gss.catalogue_tools.formats.blocks import Columns
from gss.catalogue_tools.formats.layout import BankFormat
from gss.catalogue_tools.formats.section_contents import line_index
from gss.catalogue_tools.selection.uniform_density import reduce_catalogue, survey_attitudes
from gss.domain.camera import Camera
from gss.domain.stars import StarTable
from gss.skytables.bank import BankTables, ReducedCatalogue, ReducedFrame
from gss.skytables.neighbours import neighbour_links
from gss.skytables.pairs import DistanceTable
from gss.skytables.triplets import Constellations, TripletClasses, faintest_mag, find_constellations

# Liebe 1992: 3′ (1.08 px of its camera), 5° and 25 %; the blend distance of three pixels is chosen.
DOCUMENT_UNCERTAINTY_RAD = float(np.radians(0.05))
UNCERTAINTY_PX = DOCUMENT_UNCERTAINTY_RAD / 8.073e-4
ANGLE_CLASS_RAD = float(np.radians(5.0))
BRIGHTNESS_ERROR = 0.25
BLEND_PX = 3.0
FRAME_PX = 1000


@dataclass(frozen=True)
class OwnTables:
    """Tables of a bank image except the star list: the distances that the format stores, and further tables."""

    distances: DistanceTable
    tables: BankTables


def tables_for(
    format_name: str,
    stars: StarTable,
    distances: DistanceTable,
    camera: Camera,
    *,
    limit_mag: float | None = None,
    uncertainty_rad: float | None = None,
    reduced: ReducedFrame | ReducedCatalogue | None = None,
    index: bool = False,
) -> OwnTables:
    """Compute distances and tables for :func:`registry.encode`, using the camera's parameters.

    ``limit_mag``: magnitude at which a star is detected half of the time, for the triplets of oersted; None: the
    faintest magnitude that the list allows. ``uncertainty_rad``: uncertainty of one position; None: the document's 3′,
    converted to pixels of this camera. ``reduced``: the frame of a reduced catalogue to add, or the catalogue itself;
    the distances are then limited to its stars. None: no reduced catalogue, except for far-mst, which uses the camera's
    frame. ``index``: also add a k-vector.
    """
    tables = BankTables()
    frame = reduced if reduced is not None or format_name != "far-mst" else frame_of(camera)
    if frame is not None:
        catalogue = frame if isinstance(frame, ReducedCatalogue) else reduced_catalogue(stars, frame)
        tables = replace(tables, reduced=catalogue)
        distances = pairs_among(distances, catalogue)
    if format_name in ("oersted", "aim"):
        none = np.empty(0, np.int32)
        distances = DistanceTable(none, none, np.empty(0), distances.min_rad, distances.max_rad)
    if format_name == "oersted":
        own_rad = UNCERTAINTY_PX * camera.pixel_rad if uncertainty_rad is None else uncertainty_rad
        constellations = constellations_of(stars, own_rad, camera.diagonal_rad, limit_mag, BLEND_PX * camera.pixel_rad)
        tables = replace(tables, constellations=constellations)
    if index and format_name != "far-mst":
        # ``encode()`` recomputes the k-vector at the precision stored on the device. far-mst always has a k-vector,
        # over sin².
        tables = replace(tables, index=line_index(distances.distance_rad))
    return OwnTables(distances, tables)


def constellations_of(
    stars: StarTable, uncertainty_rad: float, max_rad: float, limit_mag: float | None = None, blend_rad: float = 0.0
) -> Constellations:
    """Compute Liebe's database of a star list.

    ``limit_mag`` None: the faintest magnitude that the list allows; the list must contain stars down to 25 % below the
    limit in brightness.
    """
    finite_mag = stars.v_mag[np.isfinite(stars.v_mag)]
    if limit_mag is None:
        limit_mag = (float(finite_mag.max()) if len(finite_mag) else 99.0) - faintest_mag(0.0, BRIGHTNESS_ERROR)
    return find_constellations(
        stars.icrs,
        stars.v_mag,
        TripletClasses.of(uncertainty_rad, ANGLE_CLASS_RAD),
        limit_mag,
        max_rad,
        brightness_error=BRIGHTNESS_ERROR,
        blend_rad=blend_rad,
    )


def frame_of(camera: Camera, step_rad: float = float(np.radians(1.0))) -> ReducedFrame:
    """Return the camera's frame as the frame of a reduced catalogue."""
    width_rad, height_rad = camera.fov_rad
    return ReducedFrame(width_rad, height_rad, step_rad=step_rad)


def reduced_catalogue(stars: StarTable, frame: ReducedFrame) -> ReducedCatalogue:
    """Select the brightest stars of every upright frame."""
    shape = FieldShape(frame_camera(frame))
    rows = reduce_catalogue(stars, shape, survey_attitudes(frame.step_rad), frame.brightest).kept
    return ReducedCatalogue(rows, frame)


def frame_camera(frame: ReducedFrame) -> Camera:
    """Return a camera without distortion whose field of view is the frame."""
    camera = Camera.from_fov(FRAME_PX, FRAME_PX, frame.width_rad)
    return replace(camera, focal_row_px=FRAME_PX / (2 * np.tan(frame.height_rad / 2)))


def pairs_among(distances: DistanceTable, reduced: ReducedCatalogue) -> DistanceTable:
    """Return the pairs whose two stars are both in the reduced catalogue."""
    both = np.flatnonzero(reduced.kept[distances.first] & reduced.kept[distances.second])
    return replace(
        distances,
        first=distances.first[both],
        second=distances.second[both],
        distance_rad=distances.distance_rad[both],
    )


def completed(
    fmt: BankFormat, stars: StarTable, stored: Columns, distances: DistanceTable, tables: BankTables
) -> BankTables:
    """Add the tables that the format requires to ``tables``.

    ``stored``: columns of the pairs at the precision stored on the device. Every k-vector is computed from them.
    """
    if tables.index is not None or "KVEC" in fmt.sections:
        tables = replace(tables, index=line_index(fmt.ascending(stored)) if stored else None)
    if "LINK" in fmt.sections and tables.links is None:
        tables = replace(tables, links=neighbour_links(stars.icrs))
    if "TCLS" in fmt.sections and tables.constellations is None:
        max_rad = min(distances.max_rad, float(np.pi / 4))
        tables = replace(tables, constellations=constellations_of(stars, DOCUMENT_UNCERTAINTY_RAD, max_rad))
    return tables
