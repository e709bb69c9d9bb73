"""Star identification of Sunsat (Jacobs 1995 ch. 3). Up to eight observed stars are matched with the whole bank in lost
in space, and with the uncertainty area around the a-priori boresight in assisted mode."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gss.domain.angles import Array
from gss.domain.camera import Camera
from gss.domain.errors import BadInput
from gss.domain.results import Centroids
from gss.pipeline.chains.modes import AttitudePrior, Mode
from gss.pipeline.chains.sunsat_detect import magnitudes
from gss.pipeline.chains.sunsat_parameters import SunsatParameters
from gss.pipeline.identify.geometric_voting import Mask
from gss.pipeline.identify.match_groups import Grouping, GroupLimits, Guides, MatchGroup, match_groups
from gss.pipeline.identify.star_vectors import match_star_vectors
from gss.skytables.bank import OnboardCatalogue
from gss.skytables.pairs import DistanceTable

Rows = NDArray[np.intp]


@dataclass(frozen=True)
class SunsatCatalogue:
    """Bank prepared for the processor: unit vectors and table in full precision, right ascension and declination."""

    bank: OnboardCatalogue
    guides: Guides
    ra_rad: Array
    dec_rad: Array

    def __len__(self) -> int:
        return len(self.bank)


@dataclass(frozen=True)
class SunsatMatching:
    """Result of MATCH_STARS. (n,) per centroid used: ``unit_cam``, measured ``v_mag``, catalogue ``row`` or −1.
    ``selected``: matched centroids, empty with a ``reason``. ``looked_for``: guide stars for which a centroid was
    searched, None for all. ``hypotheses``: number of hypotheses for the false-match bound; ``searched``: number of
    stars in the uncertainty area; ``rivals``: number of groups that have the largest size; ``pairs``: number of
    matching star pairs."""

    mode: Mode
    unit_cam: Array
    v_mag: Array
    row: Rows
    selected: Rows
    weight: Array
    operations: int
    hypotheses: float
    searched: int
    rivals: int
    pairs: int
    reason: str
    looked_for: Rows | None = None

    @property
    def confidence(self) -> float:
        """Return the share of matched stars among those used."""
        return len(self.selected) / len(self.row) if len(self.row) else 0.0


def prepare(bank: OnboardCatalogue) -> SunsatCatalogue:
    """Prepare a bank in full precision. Raises :class:`BadInput` for a bank without magnitudes."""
    if len(bank) and not np.isfinite(bank.v_mag).all():
        raise BadInput(
            "Sunsat's matching needs magnitudes",
            expected="a bank in the sunsat format",
            got="a bank without magnitudes",
            hint="build the catalogue with format sunsat",
        )
    bank.need_distances()
    unit = bank.icrs.astype(float)
    unit = unit / np.linalg.norm(unit, axis=1, keepdims=True)
    t = bank.distances
    table = DistanceTable(t.first, t.second, t.distance_rad.astype(float), t.min_rad, t.max_rad)
    ra, dec = np.mod(np.arctan2(unit[:, 1], unit[:, 0]), 2 * np.pi), np.arctan2(unit[:, 2], np.hypot(*unit.T[:2]))
    return SunsatCatalogue(bank, Guides(unit, bank.v_mag.astype(float), table), ra, dec)


def candidates(
    centroids: Centroids,
    camera: Camera,
    catalogue: SunsatCatalogue,
    parameters: SunsatParameters,
    mode: Mode,
    hint: AttitudePrior | None,
    first: int = 0,
) -> tuple[SunsatMatching, ...]:
    """Run the Matching algorithm on the eight centroids from index ``first``.

    Returns one result per largest group if several disagree and acceptance is by bound, else a single result. A result
    without stars has a reason.
    """
    p = parameters
    used = centroids.take(np.arange(min(len(centroids), first + p.max_observed)))
    unit = camera.unproject(used.pixels)
    v_mag = magnitudes(used.flux_dn, p)
    grouping = _grouping(unit[first:], v_mag[first:], camera, catalogue, p, mode, hint)
    empty = SunsatMatching(
        mode=mode,
        unit_cam=unit,
        v_mag=v_mag,
        row=np.full(len(unit), -1, np.intp),
        selected=np.empty(0, np.intp),
        weight=np.zeros(len(unit)),
        operations=grouping.operations,
        hypotheses=float(grouping.pairs),
        searched=int(np.count_nonzero(_uncertainty_area(catalogue, camera, p, mode, hint))),
        rivals=len(grouping.largest),
        pairs=grouping.pairs,
        reason=grouping.reason,
    )
    if len(unit) < p.min_group:
        stars = "star" if len(unit) == 1 else "stars"
        return (replace(empty, reason=f"{len(unit) or 'no'} {stars} found in the frame; {p.min_group} needed"),)
    if grouping.group is not None:
        return (_named(empty, grouping.group, first),)
    if p.acceptance == "bound" and grouping.largest:
        return tuple(_named(empty, g, first) for g in grouping.largest)
    return (empty,)


def _grouping(
    unit: Array,
    v_mag: Array,
    camera: Camera,
    catalogue: SunsatCatalogue,
    p: SunsatParameters,
    mode: Mode,
    hint: AttitudePrior | None,
) -> Grouping:
    allowed = _uncertainty_area(catalogue, camera, p, mode, hint)
    limits = GroupLimits(p.distance_tolerance_rad, p.magnitude_tolerance_mag, p.min_group, p.clique_budget)
    if p.matcher == "star_vectors":
        return match_star_vectors(unit, v_mag, catalogue.guides, allowed, limits)
    return match_groups(unit, v_mag, catalogue.guides, limits, allowed)


def _named(empty: SunsatMatching, group: MatchGroup, first: int) -> SunsatMatching:
    order = np.argsort(group.observed)
    selected = group.observed[order] + first
    row, weight = empty.row.copy(), empty.weight.copy()
    row[selected] = group.guide[order]
    weight[list(widest_pair(empty.unit_cam, selected))] = 1.0
    return replace(empty, row=row, selected=selected, weight=weight, reason="")


def widest_pair(unit: Array, selected: Rows) -> tuple[int, ...]:
    """Return the two selected stars farthest apart, for TRIAD (Jacobs 1995 §4.1.6.1); () with fewer than two."""
    if len(selected) < 2:
        return ()
    i, j = np.triu_indices(len(selected), 1)
    k = int(np.argmax(np.linalg.norm(unit[selected[i]] - unit[selected[j]], axis=1)))
    return int(selected[i[k]]), int(selected[j[k]])


def check_hint(mode: Mode, hint: AttitudePrior | None) -> AttitudePrior:
    """Return the hint of a mode that needs one. Raises :class:`BadInput` if it is missing."""
    if hint is None:
        raise BadInput(f"{mode.value} needs a hint", expected="a boresight or an attitude", got="none")
    return hint


def last_attitude(hint: AttitudePrior | None) -> Array:
    """Return the (4,) quaternion of the last attitude for tracking. Raises :class:`BadInput` if the hint has no full attitude."""
    prior = check_hint(Mode.TRACKING, hint)
    if prior.quaternion is None:
        raise BadInput("tracking needs a hint", expected="a full attitude", got="a boresight only")
    return prior.quaternion


def _uncertainty_area(
    catalogue: SunsatCatalogue, camera: Camera, p: SunsatParameters, mode: Mode, hint: AttitudePrior | None
) -> Mask:
    """Return the mask of the guide stars that can be in view: all stars, or those around the expected boresight (§3.3, §4)."""
    if mode is Mode.LOST_IN_SPACE:
        return np.ones(len(catalogue), bool)
    prior = check_hint(mode, hint)
    return near_boresight(catalogue, prior.boresight_icrs, camera.half_diagonal_rad + p.hint_error_rad)


def near_boresight(catalogue: SunsatCatalogue, boresight_icrs: Array, radius_rad: float) -> Mask:
    """Return the mask of the guide stars within a radius of a direction."""
    boresight = np.asarray(boresight_icrs, float)
    cosine = catalogue.guides.unit @ (boresight / np.linalg.norm(boresight))
    return np.asarray(cosine >= np.cos(min(radius_rad, np.pi)))
