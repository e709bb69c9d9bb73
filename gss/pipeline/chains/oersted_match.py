"""Star identification of the Oersted star imager: triplets and a vote, or the predicted image (Liebe 1992)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gss.domain.angles import Array
from gss.domain.camera import Camera
from gss.domain.camera_profile import CameraProfile
from gss.domain.errors import BadInput
from gss.domain.results import Centroids
from gss.domain.rotation import matrix_from_quaternion, rotation_angle_rad
from gss.pipeline.attitude import svd
from gss.pipeline.chains.modes import AttitudePrior, Mode, check_hint
from gss.pipeline.chains.oersted_parameters import (
    ANGLE_CLASS_RAD,
    BLEND_PX,
    BRIGHTNESS_ERROR,
    OerstedParameters,
    detectable_mag,
    uncertainty_rad,
)
from gss.pipeline.identify.triplet_alone import attitudes_of_triplet
from gss.pipeline.identify.triplet_vote import TripletVote, vote
from gss.pipeline.track.constant_rate import extrapolate
from gss.pipeline.track.predictional import Fit, predictional_fit, shrinking_radii_rad
from gss.skytables.bank import OnboardCatalogue
from gss.skytables.triplets import TripletClasses, TripletTable, build_triplets, faintest_mag

Index = NDArray[np.intp]
MIN_FIT_STARS = 5
FURTHEST_STEP_RAD = float(np.radians(10.0))


@dataclass(frozen=True)
class OerstedCatalogue:
    """A bank prepared for the imager: the star list with unit vectors in full precision (n, 3), its triplet table, and the rows
    bright enough to be detected."""

    stars: OnboardCatalogue
    icrs: Array
    triplets: TripletTable
    detectable: Index

    def __len__(self) -> int:
        return len(self.stars)


def prepare(
    catalogue: OnboardCatalogue, profile: CameraProfile, triplets: TripletTable | None = None
) -> OerstedCatalogue:
    """Prepare the bank with the given triplets. Without ``triplets``, use those of the bank; if the bank has none,
    compute them from its stars."""
    icrs = catalogue.icrs.astype(float)
    icrs /= np.maximum(np.linalg.norm(icrs, axis=1, keepdims=True), 1e-300)
    if triplets is not None and triplets.stars != len(catalogue):
        raise BadInput(
            "the triplet table is for another star list",
            expected=f"{len(catalogue)} stars",
            got=str(triplets.stars),
        )
    if triplets is None and catalogue.tables.constellations is not None:
        triplets = catalogue.tables.constellations.table()
    if triplets is None:
        classes = TripletClasses.of(uncertainty_rad(profile), ANGLE_CLASS_RAD)
        triplets = build_triplets(
            icrs,
            catalogue.v_mag,
            classes,
            limit_mag(catalogue.v_mag, profile),
            profile.camera.diagonal_rad,
            brightness_error=BRIGHTNESS_ERROR,
            blend_rad=BLEND_PX * profile.camera.pixel_rad,
        )
    deep = faintest_mag(triplets.limit_mag, triplets.brightness_error)
    return OerstedCatalogue(catalogue, icrs, triplets, np.flatnonzero(~(catalogue.v_mag > deep)))


def limit_mag(v_mag: NDArray[np.floating], profile: CameraProfile) -> float:
    """Return the magnitude limit of the stars used from a list with magnitudes ``v_mag`` (n,). The
    limit is brighter than the faintest star of the list by the brightness uncertainty (in the document, 1107 of 1539
    stars are used), and the detector must detect the stars. Without magnitudes, return the limit of the profile."""
    finite_mag = v_mag[np.isfinite(v_mag)]
    if not len(finite_mag):
        return profile.sensor.faint_limit_mag
    return min(float(finite_mag.max()), detectable_mag(profile)) - faintest_mag(0.0, BRIGHTNESS_ERROR)


@dataclass(frozen=True)
class OerstedMatching:
    """Result of MATCH_STARS. Per centroid, (n,): ``row`` or −1, ``votes`` of other triplets (1 in tracking). ``selected``:
    indices of the centroids used for the attitude; if it is empty, ``reason`` states why. ``cam_from_icrs``: fitted attitude.
    Counts: ``triplets`` measured in the image, matching ``candidates`` in the triplet table, and distances ``compared``."""

    mode: Mode
    unit_cam: Array
    row: Index
    votes: Index
    selected: Index
    cam_from_icrs: Array | None
    triplets: int
    candidates: int
    compared: int
    reason: str

    @property
    def weight(self) -> Array:
        """Return (n,) ones, because the least-squares fit of the document has no weights."""
        return (self.row >= 0).astype(float)

    @property
    def operations(self) -> int:
        """Return the number of matching references plus the number of distances compared."""
        return self.candidates + self.compared

    @property
    def confidence(self) -> float:
        """Return the share of identified centroids."""
        return len(self.selected) / len(self.row) if len(self.row) else 0.0


def match_stars(
    centroids: Centroids,
    camera: Camera,
    catalogue: OerstedCatalogue,
    parameters: OerstedParameters,
    mode: Mode = Mode.LOST_IN_SPACE,
    hint: AttitudePrior | None = None,
) -> OerstedMatching:
    """Identify centroids: initial estimate in lost in space and assisted mode, predictional estimate in tracking (Liebe
    1992, "Algorithms").

    The predicted image also completes the initial estimate, because triplets omit the stars near the edge.
    """
    check_hint(mode, hint)
    unit = camera.unproject(centroids.pixels)
    # A centroid outside the domain of the distortion has no direction. It remains in the arrays but is not used.
    good = np.flatnonzero(np.isfinite(unit).all(axis=1))
    if mode is Mode.TRACKING and hint is not None:
        return _track(unit, good, camera, catalogue, parameters, hint)
    allowed = _allowed(catalogue, mode, hint, parameters)
    ballot = vote(unit[good], camera, catalogue.triplets, catalogue.icrs, allowed, 2 * parameters.uncertainty_rad)
    fit = _initial_fit(unit[good], ballot, camera, catalogue, parameters)
    votes = np.zeros(len(unit), np.intp)
    votes[good] = ballot.votes
    compared = ballot.comparisons + (0 if fit is None else fit.compared)
    figures = len(ballot.triplet), len(ballot.candidate), compared
    return _matching(mode, unit, good, fit, votes, figures, parameters)


def _allowed(
    catalogue: OerstedCatalogue, mode: Mode, hint: AttitudePrior | None, parameters: OerstedParameters
) -> NDArray[np.bool_]:
    if mode is Mode.LOST_IN_SPACE or hint is None:
        return np.ones(len(catalogue), bool)
    boresight = np.asarray(hint.boresight_icrs, float)
    return np.asarray(
        catalogue.icrs @ (boresight / np.linalg.norm(boresight)) >= np.cos(parameters.assisted_radius_rad)
    )


def _initial_fit(
    unit: Array, ballot: TripletVote, camera: Camera, catalogue: OerstedCatalogue, parameters: OerstedParameters
) -> Fit | None:
    """Fit the stars identified by the vote, then the image predicted from them. If too few stars match, use the best
    fit that starts from a single triplet."""
    radii = shrinking_radii_rad(2 * parameters.uncertainty_rad, parameters.uncertainty_rad)

    def fit_from(attitude: Array) -> Fit | None:
        return predictional_fit(unit, catalogue.icrs, catalogue.detectable, attitude, radii, camera.half_diagonal_rad)

    identified = np.flatnonzero(ballot.row >= 0)
    best = fit_from(svd(unit[identified], catalogue.icrs[ballot.row[identified]])) if len(identified) >= 2 else None
    compared = 0 if best is None else best.compared
    if best is None or len(best.row) < MIN_FIT_STARS:
        for k in range(min(parameters.triplets_alone, len(ballot.candidate))):
            triplet = unit[ballot.triplet[ballot.which[k]]]
            for attitude in attitudes_of_triplet(
                triplet, int(ballot.candidate[k]), catalogue.icrs, 2 * parameters.uncertainty_rad
            ):
                fit = fit_from(attitude)
                compared += 0 if fit is None else fit.compared
                if fit is not None and (best is None or len(fit.row) > len(best.row)):
                    best = fit
    return None if best is None else replace(best, compared=compared)


def _track(
    unit: Array,
    good: Index,
    camera: Camera,
    catalogue: OerstedCatalogue,
    parameters: OerstedParameters,
    hint: AttitudePrior,
) -> OerstedMatching:
    """Match the image predicted at the attitude extrapolated from the last two attitudes or, if it does not fit, at the
    last attitude."""
    radii = shrinking_radii_rad(parameters.capture_rad, parameters.uncertainty_rad)
    best, compared = None, 0
    for attitude in predicted_attitudes(hint):
        fit = predictional_fit(
            unit[good], catalogue.icrs, catalogue.detectable, attitude, radii, camera.half_diagonal_rad
        )
        compared += fit.compared if fit is not None else 0
        if fit is not None and (best is None or len(fit.row) > len(best.row)):
            best = fit
    votes = np.zeros(len(unit), np.intp)
    if best is not None:
        votes[good[best.measured]] = 1
    return _matching(Mode.TRACKING, unit, good, best, votes, (0, 0, compared), parameters)


def predicted_attitudes(hint: AttitudePrior) -> list[Array]:
    """Return the (3, 3) attitudes to try: extrapolated at the rate of the last two estimates, and unchanged."""
    if hint.quaternion is None:
        return []
    last = matrix_from_quaternion(hint.quaternion)
    if not hint.earlier:
        return [last]
    ahead = extrapolate(hint.quaternion, hint.earlier[0], hint.steps)
    return [ahead, last] if rotation_angle_rad(ahead, last) <= FURTHEST_STEP_RAD else [last]


def _matching(
    mode: Mode,
    unit: Array,
    good: Index,
    fit: Fit | None,
    votes: Index,
    figures: tuple[int, int, int],
    parameters: OerstedParameters,
) -> OerstedMatching:
    row, selected = np.full(len(unit), -1, np.intp), np.empty(0, np.intp)
    if fit is not None:
        selected = good[fit.measured]
        row[selected] = fit.row
    reason = _too_few(len(unit), figures[0], len(selected), parameters.min_verified(mode), mode)
    return OerstedMatching(
        mode,
        unit,
        row,
        votes,
        selected if not reason else selected[:0],
        None if fit is None else fit.cam_from_icrs,
        *figures,
        reason,
    )


def _too_few(centroids: int, triplets: int, verified: int, needed: int, mode: Mode) -> str:
    if centroids == 0:
        return "no star found in the frame"
    if verified >= needed:
        return ""
    if mode is not Mode.TRACKING and triplets == 0:
        return f"no triplet among {centroids} centroids is completely inside the frame"
    noun = "centroid" if centroids == 1 else "centroids"
    return f"{verified} of {centroids} {noun} verified; {needed} needed in {mode.value.replace('_', ' ')} mode"
