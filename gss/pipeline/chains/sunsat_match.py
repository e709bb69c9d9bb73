"""Naming stars as Sunsat does (Jacobs 1995 ch. 3): up to eight observed stars against the bank, the whole of it when lost,
the uncertainty area round the a-priori boresight when assisted."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gss.domain.angles import Array
from gss.domain.camera import Camera
from gss.domain.errors import BadInput
from gss.domain.results import Centroids
from gss.domain.stars import DistanceTable, OnboardCatalogue
from gss.pipeline.chains.modes import Hint, Mode
from gss.pipeline.chains.sunsat_detect import magnitudes
from gss.pipeline.chains.sunsat_parameters import SunsatParameters
from gss.pipeline.identify.geometric_voting import Mask, reduced_table
from gss.pipeline.identify.match_groups import Grouping, GroupLimits, Guides, match_groups
from gss.pipeline.identify.star_vectors import match_star_vectors

Rows = NDArray[np.intp]


@dataclass(frozen=True)
class SunsatCatalogue:
    """A bank as the processor uses it: full-width unit vectors and table, right ascension and declination."""

    bank: OnboardCatalogue
    guides: Guides
    ra_rad: Array
    dec_rad: Array

    def __len__(self) -> int:
        return len(self.bank)


@dataclass(frozen=True)
class SunsatMatching:
    """MATCH_STARS. (n,) per centroid looked at: ``unit_cam``, ``v_mag`` measured, ``row`` of the catalogue or −1.
    ``selected``: matched centroids, empty with a ``reason``. ``hypotheses``: how many guesses an accident had to be right in
    one; ``searched``: stars of the uncertainty area; ``rivals``: largest groups, ``pairs``: matching star pairs."""

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

    @property
    def confidence(self) -> float:
        """Share of the stars looked at that are matched."""
        return len(self.selected) / len(self.row) if len(self.row) else 0.0


def prepare(bank: OnboardCatalogue) -> SunsatCatalogue:
    """Widen a bank once. Magnitudes are needed: a bank without them is refused."""
    if len(bank) and not np.isfinite(bank.v_mag).all():
        raise BadInput(
            "Sunsat's matching needs magnitudes",
            expected="a bank in the sunsat format",
            got="a bank without magnitudes",
            hint="build the catalogue with format sunsat",
        )
    unit = bank.icrs.astype(float)
    unit = unit / np.linalg.norm(unit, axis=1, keepdims=True)
    t = bank.distances
    table = DistanceTable(t.first, t.second, t.distance_rad.astype(float), t.min_rad, t.max_rad)
    ra, dec = np.mod(np.arctan2(unit[:, 1], unit[:, 0]), 2 * np.pi), np.arctan2(unit[:, 2], np.hypot(*unit.T[:2]))
    return SunsatCatalogue(bank, Guides(unit, bank.v_mag.astype(float), table), ra, dec)


def match_lost_or_assisted(
    centroids: Centroids,
    camera: Camera,
    catalogue: SunsatCatalogue,
    parameters: SunsatParameters,
    mode: Mode,
    hint: Hint | None,
) -> SunsatMatching:
    """The Matching algorithm on the brightest eight."""
    p = parameters
    used = centroids.take(np.arange(min(len(centroids), p.max_observed)))
    unit = camera.unproject(used.pixels)
    v_mag = magnitudes(used.flux_dn, p)
    allowed = _uncertainty_area(catalogue, camera, p, mode, hint)
    limits = GroupLimits(p.distance_tolerance_rad, p.magnitude_tolerance_mag, p.min_group, p.clique_budget)
    if p.matcher == "star_vectors":
        grouping = match_star_vectors(unit, v_mag, catalogue.guides, allowed, limits)
    else:
        g = catalogue.guides
        table = g.table if allowed.all() else reduced_table(g.table, allowed)
        grouping = match_groups(unit, v_mag, Guides(g.unit, g.v_mag, table), limits)
    return _matching(mode, unit, v_mag, grouping, int(np.count_nonzero(allowed)), p)


def _matching(
    mode: Mode, unit: Array, v_mag: Array, grouping: Grouping, searched: int, p: SunsatParameters
) -> SunsatMatching:
    row = np.full(len(unit), -1, np.intp)
    selected = np.empty(0, np.intp)
    reason = grouping.reason
    if len(unit) < p.min_group:
        stars = "star" if len(unit) == 1 else "stars"
        reason = f"{len(unit) or 'no'} {stars} found in the frame; {p.min_group} needed"
    elif grouping.group is not None and not reason:
        order = np.argsort(grouping.group.observed)
        selected = grouping.group.observed[order]
        row[selected] = grouping.group.guide[order]
    weight = np.zeros(len(unit))
    weight[list(widest_pair(unit, selected))] = 1.0
    return SunsatMatching(
        mode,
        unit,
        v_mag,
        row,
        selected,
        weight,
        grouping.operations,
        float(grouping.pairs),
        searched,
        grouping.rivals,
        grouping.pairs,
        reason,
    )


def widest_pair(unit: Array, selected: Rows) -> tuple[int, ...]:
    """The two selected stars farthest apart, for TRIAD (Jacobs 1995 §4.1.6.1); () with fewer than two."""
    if len(selected) < 2:
        return ()
    i, j = np.triu_indices(len(selected), 1)
    k = int(np.argmax(np.linalg.norm(unit[selected[i]] - unit[selected[j]], axis=1)))
    return int(selected[i[k]]), int(selected[j[k]])


def check_hint(mode: Mode, hint: Hint | None) -> Hint:
    """The hint of a mode that needs one, refused where there is none."""
    if hint is None:
        raise BadInput(f"{mode.value} needs a hint", expected="a boresight or an attitude", got="none")
    return hint


def last_attitude(hint: Hint | None) -> Array:
    """(4,) quaternion that tracking starts from, refused where the hint holds none."""
    known = check_hint(Mode.TRACKING, hint)
    if known.quaternion is None:
        raise BadInput("tracking needs a hint", expected="a full attitude", got="a boresight only")
    return known.quaternion


def _uncertainty_area(
    catalogue: SunsatCatalogue, camera: Camera, p: SunsatParameters, mode: Mode, hint: Hint | None
) -> Mask:
    """The guide stars that may be in view: all, or those round the expected boresight (§3.3, §4)."""
    if mode is Mode.LOST_IN_SPACE:
        return np.ones(len(catalogue), bool)
    known = check_hint(mode, hint)
    return near_boresight(catalogue, known.boresight_icrs, camera.half_diagonal_rad + p.hint_error_rad)


def near_boresight(catalogue: SunsatCatalogue, boresight_icrs: Array, radius_rad: float) -> Mask:
    """Which guide stars are within the radius of a direction."""
    boresight = np.asarray(boresight_icrs, float)
    cosine = catalogue.guides.unit @ (boresight / np.linalg.norm(boresight))
    return np.asarray(cosine >= np.cos(min(radius_rad, np.pi)))
