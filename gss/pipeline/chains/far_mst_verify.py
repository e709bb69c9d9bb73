"""Extension of a partial identification: prediction of the bank's stars, matching of centroids, and false-match bound."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from gss.domain.angles import Array, lengths
from gss.domain.camera import Camera
from gss.pipeline.chains.far_mst_catalogue import FarMstCatalogue
from gss.pipeline.chains.far_mst_parameters import FarMstParameters
from gss.pipeline.chains.proof import solid_angle_sr
from gss.pipeline.identify.accidental import accidental_bound, chance_within
from gss.pipeline.identify.soundness import separate_stars
from gss.pipeline.small import best_rotation
from gss.pipeline.track.rate_match import mutual_nearest
from gss.skytables.kvector import Rows

# The first attitude is computed from a few stars, which can be close together. Therefore the search radius is wide at
# first and then shrinks.
WIDENINGS = (3.0, 1.5, 1.0)
# The fit adapts to the stars that it collects, so accidental matches can occur within a radius that is larger than the
# last radius.
ROOM = 1.5
# Companions closer than two search radii of the first round match together, so they are not independent evidence.
COMPANION_RADII = 2 * WIDENINGS[0]


@dataclass(frozen=True)
class Identified:
    """Extended identification. ``row``: (n,) catalogue rows, −1 if not identified; ``count``: number identified, of
    ``in_view`` stars of the bank in this field, with density ``per_sr``; ``separate``: number identified, where close
    companions count as one; ``cam_from_icrs``: fitted attitude; ``chance``: probability that a random direction matches."""

    row: Rows
    count: int
    separate: int
    in_view: int
    cam_from_icrs: Array
    per_sr: float
    chance: float

    @property
    def share(self) -> float:
        """Return the number of identified stars divided by the smaller of the number of centroids and the number of
        stars in view."""
        return self.count / max(1, min(len(self.row), self.in_view))

    def bound(self, hypotheses: float) -> float:
        """Return an upper bound on the expected number of accidental matches of this quality among ``hypotheses``."""
        return accidental_bound(hypotheses, self.separate, len(self.row), self.chance)


def pair_tolerance_rad(sigma_rad: Array, pixel_rad: float, p: FarMstParameters) -> Array:
    """Return the (n, n) tolerances for the difference between measured and catalogue angles (dossier §3.15)."""
    return np.asarray(p.sigmas * np.hypot(sigma_rad[:, None], sigma_rad[None]) + p.floor_px * pixel_rad)


def star_radius_rad(sigma_rad: Array, pixel_rad: float, p: FarMstParameters) -> Array:
    """Return the (n,) maximum distances of stars from their predicted positions, both axes combined."""
    return np.asarray(p.sigmas * 1.15 * sigma_rad + p.floor_px * pixel_rad)


def complete(
    unit_cam: Array,
    sigma_rad: Array,
    centroid: Rows,
    row: Rows,
    catalogue: FarMstCatalogue,
    camera: Camera,
    p: FarMstParameters,
) -> Identified | None:
    """Extend a few matches (``centroid`` is catalogue ``row``) to all consistent ones; None if the initial matches do
    not fit one attitude."""
    radius = star_radius_rad(sigma_rad, camera.pixel_rad, p)
    weight = 1.0 / sigma_rad**2
    rotation = best_rotation(unit_cam[centroid], catalogue.icrs[row], weight[centroid])
    miss = lengths(catalogue.icrs[row] @ rotation.T - unit_cam[centroid])
    if np.any(miss > radius[centroid]):
        return None
    in_view = np.empty(0, np.intp)
    names = np.full(len(unit_cam), -1, np.intp)
    for widening in WIDENINGS:
        in_view = stars_in_view(catalogue.icrs, rotation, camera)
        predicted = catalogue.icrs[in_view] @ rotation.T
        pairs = mutual_nearest(predicted, unit_cam, widening * float(radius.max()))
        off = lengths(predicted[pairs[:, 0]] - unit_cam[pairs[:, 1]])
        pairs = pairs[off <= widening * radius[pairs[:, 1]]]
        if len(pairs) < 2:
            return None
        names[:] = -1
        names[pairs[:, 1]] = in_view[pairs[:, 0]]
        matched = np.sort(pairs[:, 1])
        rotation = best_rotation(unit_cam[matched], catalogue.icrs[names[matched]], weight[matched])
    names = _still_near(names, unit_cam, radius, rotation, catalogue.icrs)
    per_sr = max(1, len(in_view)) / solid_angle_sr(camera)
    chance = chance_within(per_sr, ROOM * float(radius.max()))
    identified = unit_cam[names >= 0]
    separate = separate_stars(identified, COMPANION_RADII * float(radius.max()))
    return Identified(names, len(identified), separate, len(in_view), rotation, per_sr, chance)


def _still_near(names: Rows, unit_cam: Array, radius: Array, rotation: Array, icrs: Array) -> Rows:
    """Return the catalogue rows with residuals of the last fit within the radius; −1 for the others."""
    matched = np.flatnonzero(names >= 0)
    off = lengths(icrs[names[matched]] @ rotation.T - unit_cam[matched])
    names[matched[off > radius[matched]]] = -1
    return names


def stars_in_view(icrs: Array, cam_from_icrs: Array, camera: Camera) -> Rows:
    """Return the rows of the (n, 3) directions that are on the detector or a few pixels beside it."""
    near = np.flatnonzero(icrs @ cam_from_icrs[2] > np.cos(min(_half_diagonal_rad(camera) + 0.01, 1.5)))
    pixels = camera.project(icrs[near] @ cam_from_icrs.T)
    return near[camera.contains(pixels, -5.0)]


@lru_cache(maxsize=16)
def _half_diagonal_rad(camera: Camera) -> float:
    return camera.half_diagonal_rad
