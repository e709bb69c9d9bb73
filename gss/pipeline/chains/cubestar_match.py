"""Star identification of CubeStar: votes over pairs, or the nearest predicted star (Erlank 2013 §4.3–4.5)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gss.domain.angles import Array
from gss.domain.camera import Brown, BrownUndistort, Camera
from gss.domain.errors import BadInput
from gss.domain.results import Centroids
from gss.domain.rotation import matrix_from_quaternion
from gss.pipeline.chains.cubestar_parameters import CubestarParameters
from gss.pipeline.chains.modes import AttitudePrior, Mode, check_hint
from gss.pipeline.identify.geometric_voting import (
    Mask,
    Rows,
    agreement,
    cluster,
    mutually_consistent,
    pairs_of,
    reduced_table,
    vote,
)
from gss.pipeline.track.nearest import match_nearest
from gss.skytables.bank import OnboardCatalogue


def unit_vectors(centroids: Centroids, camera: Camera, undistort: str = "exact") -> Array:
    """Return the (n, 3) camera-frame directions (Erlank 2013 eq. 4.1.3–6)."""
    if undistort == "document":
        camera = replace(camera, distortion=document_distortion(camera))
    return camera.unproject(centroids.pixels)


def document_distortion(camera: Camera) -> BrownUndistort:
    """Return the device's approximation of the distortion: Brown's polynomial from measured to ideal, with the signs of
    the calibration toolbox inverted."""
    d = camera.distortion
    if not isinstance(d, Brown):
        raise BadInput(
            "the document's correction needs Brown coefficients", expected="Brown distortion", got=type(d).__name__
        )
    return BrownUndistort(-d.k1, -d.k2, -d.p1, -d.p2)


@dataclass(frozen=True)
class CubestarMatching:
    """Result of MATCH_STARS for n used centroids. ``row``: (n,) catalogue row with the most votes, −1 without a
    match; ``first_votes``, ``verification_votes``: (n,) votes of the two rounds. ``selected``: centroids used
    for the attitude, empty with a ``reason``. ``searched``: number of stars in the (reduced) catalogue;
    ``hits``: number of matching table entries."""

    mode: Mode
    unit_cam: Array
    row: Rows
    first_votes: Rows
    verification_votes: NDArray[np.int64]
    selected: Rows
    searched: int
    hits: int
    reason: str

    @property
    def weight(self) -> Array:
        """Return the (n,) verification votes."""
        return self.verification_votes.astype(float)

    @property
    def operations(self) -> int:
        """Return the number of matching table entries."""
        return self.hits

    @property
    def confidence(self) -> float:
        """Return the mean number of verification votes of the selected stars divided by the maximum; 0 if no star is selected."""
        max_votes = len(self.row) - 1
        return (
            float(np.mean(self.verification_votes[self.selected]) / max_votes)
            if len(self.selected) and max_votes
            else 0.0
        )


def match_stars(
    centroids: Centroids,
    camera: Camera,
    catalogue: OnboardCatalogue,
    parameters: CubestarParameters,
    mode: Mode = Mode.LOST_IN_SPACE,
    hint: AttitudePrior | None = None,
) -> CubestarMatching:
    """Identify centroids (Erlank 2013 §4.3–4.5). Only the first ``max_centroids`` are used."""
    check_hint(mode, hint)
    used = centroids.take(np.arange(min(len(centroids), parameters.max_centroids)))
    unit = unit_vectors(used, camera, parameters.undistort)
    # A centroid outside the distortion's domain has no direction. It stays in the arrays but is not used.
    good = np.flatnonzero(np.isfinite(unit).all(axis=1))
    allowed = _allowed(catalogue, mode, hint, parameters)
    pairs = pairs_of(unit[good])
    row, first_votes = np.full(len(unit), -1, np.intp), np.zeros(len(unit), np.intp)
    hits = 0
    if mode is Mode.TRACKING:
        row[good] = _tracked(unit[good], catalogue, allowed, hint, parameters)
        first_votes[good] = row[good] >= 0
    else:
        table = catalogue.distances if mode is Mode.LOST_IN_SPACE else reduced_table(catalogue.distances, allowed)
        ballot = vote(pairs, len(good), table, len(catalogue), parameters.tolerance_rad)
        row[good], first_votes[good], hits = ballot.row, ballot.votes, ballot.hits
    agree = agreement(pairs, row[good], catalogue, parameters.tolerance_rad)
    votes = np.zeros(len(unit), np.int64)
    votes[good] = agree.sum(axis=1)
    selected = good[mutually_consistent(agree, cluster(votes[good], parameters.vote_margin))]
    reason = _too_few(len(unit), len(selected), parameters.min_verified(mode), mode)
    selected = selected if not reason else selected[:0]
    return CubestarMatching(mode, unit, row, first_votes, votes, selected, int(np.count_nonzero(allowed)), hits, reason)


def _allowed(
    catalogue: OnboardCatalogue, mode: Mode, hint: AttitudePrior | None, parameters: CubestarParameters
) -> Mask:
    """Return the mask of the reduced catalogue: stars within D_max of the approximate boresight (Erlank 2013 §4.3.4),
    or all stars in lost in space."""
    if mode is Mode.LOST_IN_SPACE or hint is None:
        return np.ones(len(catalogue), bool)
    boresight = np.asarray(hint.boresight_icrs, float)
    cosine = catalogue.icrs.astype(float) @ (boresight / np.linalg.norm(boresight))
    return np.asarray(cosine >= np.cos(parameters.assisted_radius_rad))


def _tracked(
    unit: Array, catalogue: OnboardCatalogue, allowed: Mask, hint: AttitudePrior | None, parameters: CubestarParameters
) -> Rows:
    if hint is None or hint.quaternion is None:
        return np.full(len(unit), -1, np.intp)
    predicted = catalogue.icrs.astype(float) @ matrix_from_quaternion(hint.quaternion).T
    return match_nearest(unit, predicted, allowed, parameters.tracking_radius_rad)


def _too_few(centroids: int, verified: int, needed: int, mode: Mode) -> str:
    if centroids == 0:
        return "no star found in the frame"
    if verified >= needed:
        return ""
    stars = "centroid" if centroids == 1 else "centroids"
    return f"{verified} of {centroids} {stars} verified; {needed} needed in {mode.value.replace('_', ' ')} mode"
