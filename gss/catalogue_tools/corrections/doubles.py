"""Policies for stars that the camera cannot resolve.

``moniteq``: around each star, brightest first, all stars within the blur are merged into an effective centre of light.
A blend that does not look like one star is rejected (Moniteq 1983 §2.2). ``huffman``: every group closer than the
lens's resolving power becomes one entry (Huffman 2006 §5.5.4, eqs. 6.1 and 6.2). ``erlank_combine`` and
``erlank_keep``: the two options of Erlank 2013 §4.3.2: replace both stars by one at the averaged position, or leave
both in the list. ``drop`` (policy of GSS): remove every star whose image is disturbed by a neighbour.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from gss.domain.angles import Array, separation_rad
from gss.domain.camera_profile import CameraProfile
from gss.domain.errors import BadInput
from gss.domain.stars import FLAG_MULTIPLE, StarTable

POLICIES = ("moniteq", "huffman", "erlank_combine", "erlank_keep", "drop")
# This value is chosen: at 4σ, the dip between two equal images is a quarter of the height of their peaks, and a
# threshold begins to separate the images.
SEPARABLE_SIGMAS = 4.0
# This value is chosen, because the document does not state a value. At half a σ, the blend is 12 % wider than one star.
MAX_BROADENING = 0.5
CONTAMINANT_MAG = 9.0
# Difference of magnitude for which a fainter neighbour shifts the common centroid by less than a tenth of the
# separation.
HARMLESS_DIFFERENCE_MAG = 2.5


@dataclass(frozen=True)
class Doubles:
    """A policy and its parameters.

    ``separation_rad`` None: the smallest separation that the camera resolves. ``contaminant_mag`` and
    ``largest_broadening`` (extra spread of a blend in σ of the camera's point image) apply to ``moniteq`` only.
    """

    policy: str = "moniteq"
    separation_rad: float | None = None
    contaminant_mag: float = CONTAMINANT_MAG
    largest_broadening: float = MAX_BROADENING

    def __post_init__(self) -> None:
        if self.policy not in POLICIES:
            raise BadInput("unknown policy for double stars", expected=" | ".join(POLICIES), got=str(self.policy))
        if self.separation_rad is not None and not 0 < self.separation_rad < np.radians(5):
            raise BadInput(
                "separation of doubles is out of range",
                expected="more than 0, below 5°",
                got=f"{self.separation_rad:g} rad",
            )
        if not (self.largest_broadening > 0 and np.isfinite(self.contaminant_mag)):
            raise BadInput(
                "limits for doubles are impossible",
                expected="a broadening above 0 and a magnitude",
                got=f"{self.largest_broadening:g}, {self.contaminant_mag:g}",
            )


@dataclass(frozen=True)
class Merged:
    """Result of a policy.

    ``stars``: remaining stars, in the order of the input. ``rejected``: rows that were removed, unmodified. ``groups``:
    number of effective centres. ``members``: number of stars merged into these centres. ``largest_shift_rad``: largest
    distance between a centre and the brightest star merged into it.
    """

    stars: StarTable
    rejected: StarTable
    groups: int
    members: int
    largest_shift_rad: float
    separation_rad: float


def separable_rad(profile: CameraProfile) -> float:
    """Smallest separation at which the camera resolves two stars."""
    return SEPARABLE_SIGMAS * profile.sensor.psf_sigma_px * profile.camera.pixel_rad


def merge(stars: StarTable, doubles: Doubles, profile: CameraProfile | None = None) -> Merged:
    """Apply a policy. The result does not depend on the order of the rows."""
    reach = doubles.separation_rad
    if reach is None:
        if profile is None:
            raise BadInput("doubles need a separation", expected="a separation or a camera profile")
        reach = separable_rad(profile)
    pairs = _pairs(stars, reach)
    if doubles.policy == "erlank_keep" or not len(pairs):
        return Merged(stars, stars.take(np.zeros(len(stars), bool)), 0, 0, 0.0, reach)
    if doubles.policy == "drop":
        return _drop(stars, pairs, reach)
    if doubles.policy == "moniteq":
        sigma = profile.sensor.psf_sigma_px * profile.camera.pixel_rad if profile else reach / SEPARABLE_SIGMAS
        group = _brightest_neighbour(stars, pairs, doubles.contaminant_mag)
        return _merged(stars, group, reach, widest_rad=doubles.largest_broadening * sigma)
    n = len(stars)
    graph = coo_array((np.ones(len(pairs), np.int8), (pairs[:, 0], pairs[:, 1])), shape=(n, n))
    _, chains = connected_components(graph, directed=False)
    return _merged(stars, chains, reach, by_light=doubles.policy == "huffman")


def spoiled(stars: StarTable, reach_rad: float) -> NDArray[np.bool_]:
    """Return the (n,) mask of stars whose image is disturbed by a neighbour within ``reach_rad``. In each pair, the
    fainter star is disturbed. The brighter star is also disturbed, unless its neighbour is faint enough to be
    harmless."""
    marked = np.zeros(len(stars), bool)
    pairs = _pairs(stars, reach_rad)
    if len(pairs):
        faint, bright = _faint_bright(stars, pairs)
        marked[faint] = True
        marked[bright[stars.v_mag[faint] - stars.v_mag[bright] < HARMLESS_DIFFERENCE_MAG]] = True
    return marked


def _pairs(stars: StarTable, reach_rad: float) -> NDArray[np.intp]:
    if len(stars) < 2:
        return np.zeros((0, 2), np.intp)
    pairs = cKDTree(stars.icrs).query_pairs(2 * np.sin(reach_rad / 2), output_type="ndarray")
    return np.asarray(pairs, np.intp).reshape(-1, 2)


def _rank(stars: StarTable) -> NDArray[np.intp]:
    """Return the rank of each star by brightness. Ties are ordered by star number, so the order of the rows has no
    effect."""
    rank = np.empty(len(stars), np.intp)
    rank[np.lexsort((stars.hip, stars.v_mag))] = np.arange(len(stars))
    return rank


def _faint_bright(stars: StarTable, pairs: NDArray[np.intp]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    rank = _rank(stars)
    first_brighter = rank[pairs[:, 0]] < rank[pairs[:, 1]]
    bright = np.where(first_brighter, pairs[:, 0], pairs[:, 1])
    return np.where(first_brighter, pairs[:, 1], pairs[:, 0]), bright


def _drop(stars: StarTable, pairs: NDArray[np.intp], reach: float) -> Merged:
    bad = spoiled(stars, reach)
    return Merged(stars.take(~bad), stars.take(bad), 0, 0, 0.0, reach)


def _brightest_neighbour(stars: StarTable, pairs: NDArray[np.intp], contaminant_mag: float) -> NDArray[np.intp]:
    """Return, for each of n stars, the row of the star with which it is merged. Stars fainter than ``contaminant_mag``
    are not merged."""
    faint, bright = _faint_bright(stars, pairs)
    counts = stars.v_mag[faint] <= contaminant_mag
    faint, bright = faint[counts], bright[counts]
    rank = _rank(stars)
    centre = np.arange(len(stars), dtype=np.intp)
    # Pairs are processed in descending brightness. A star that is merged into a centre can neither be a centre nor be
    # merged into a second centre.
    for k in np.lexsort((rank[faint], rank[bright])):
        if centre[bright[k]] == bright[k] and centre[faint[k]] == faint[k]:
            centre[faint[k]] = bright[k]
    return centre


def _merged(
    stars: StarTable, group: NDArray[np.intp], reach: float, *, by_light: bool = True, widest_rad: float = np.inf
) -> Merged:
    """Merge each group of two or more stars into one star with the name, motion, colour and row of its brightest
    member."""
    _, group = np.unique(group, return_inverse=True)
    size = np.bincount(group)
    count = len(size)
    # Members are summed in descending brightness, so rounding does not depend on the order of the rows.
    order = np.argsort(_rank(stars), kind="stable")
    leader = np.empty(count, np.intp)
    leader[group[order[::-1]]] = order[::-1]
    light = 10 ** (-0.4 * stars.v_mag)
    total = np.bincount(group[order], light[order], count)
    weight = light / total[group] if by_light else 1.0 / size[group]
    mean = np.column_stack([np.bincount(group[order], (weight * axis)[order], count) for axis in stars.icrs.T])
    centre = mean / np.linalg.norm(mean, axis=1, keepdims=True)
    several = size > 1
    star_like = _extra_spread_rad(stars.icrs, weight, group, centre, several) <= widest_rad
    leaders = np.sort(leader[star_like])
    lead = group[leaders]
    joined = several[lead]
    result = stars.take(leaders)
    result = replace(
        result,
        icrs=np.where(joined[:, None], centre[lead], result.icrs),
        v_mag=np.where(joined, -2.5 * np.log10(total[lead]), result.v_mag),
        flags=np.where(joined, result.flags | FLAG_MULTIPLE, result.flags).astype(np.uint16),
    )
    shift = separation_rad(centre, stars.icrs[leader])[several & star_like]
    return Merged(
        result,
        stars.take(~star_like[group]),
        int(np.count_nonzero(several & star_like)),
        int(size[several & star_like].sum()),
        float(shift.max()) if len(shift) else 0.0,
        reach,
    )


def _extra_spread_rad(
    unit: Array, weight: Array, group: NDArray[np.intp], centre: Array, several: NDArray[np.bool_]
) -> Array:
    """Return, for each group, the largest standard deviation of its light about its centre in any direction; 0 for
    single stars."""
    spread = np.zeros(len(several))
    rows = np.flatnonzero(several[group])
    if len(rows):
        offset = unit[rows] - centre[group[rows]]
        outer = weight[rows, None, None] * offset[:, :, None] * offset[:, None, :]
        tensor = np.zeros((len(several), 3, 3))
        np.add.at(tensor, group[rows], outer)
        spread[several] = np.sqrt(np.maximum(np.linalg.eigvalsh(tensor[several])[:, -1], 0.0))
    return spread
