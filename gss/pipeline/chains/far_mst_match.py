"""Star identification of FAR-MST: n-vertex or pyramid when lost, rate match while tracking (Huffman 2006 ch. 5).

The choice of matcher follows Fig. 8.2 as far as the figure is documented. It depends on the number of stars and on the
prior knowledge. If a matcher fails, the next matcher is tried.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from gss.domain.angles import Array
from gss.domain.camera import Camera
from gss.domain.results import Centroids
from gss.domain.rotation import matrix_from_quaternion, quaternion_from_matrix
from gss.pipeline.chains.far_mst_catalogue import FarMstCatalogue
from gss.pipeline.chains.far_mst_parameters import HINT_ERROR_RAD, FarMstParameters
from gss.pipeline.chains.far_mst_verify import Identified, complete, pair_tolerance_rad, stars_in_view
from gss.pipeline.chains.modes import AttitudePrior, Mode, check_hint
from gss.pipeline.chains.proof import hint_error_rad, off_hint
from gss.pipeline.identify.accidental import tracking_hypotheses
from gss.pipeline.identify.baselines import Baselines, baselines
from gss.pipeline.identify.frame_matching import angle_matrix_rad
from gss.pipeline.identify.geometric_voting import mutually_consistent
from gss.pipeline.identify.n_vertex import figures, match_figure, same_handed
from gss.pipeline.identify.pivoting import pivot_orders, pivoted
from gss.pipeline.identify.triad_pyramid import pyramids
from gss.pipeline.track.constant_rate import extrapolate
from gss.pipeline.track.rate_match import mutual_nearest
from gss.skytables.kvector import Rows
from gss.skytables.sin2 import Sin2Directory

MAX_NAMES_PER_FIGURE = 4
ORDER = (Mode.LOST_IN_SPACE, Mode.ASSISTED, Mode.TRACKING)
NONE = np.empty(0, np.intp)


@dataclass(frozen=True)
class FarMstMatching:
    """Result of MATCH_STARS. Per centroid used, (n,): ``row`` catalogue row or −1, ``weight`` 1/σ² in 1/px². ``selected``:
    centroids used for the attitude, empty with a ``reason``. ``method``: matcher that succeeded. ``operations``: number of matching
    directory entries; ``figures``: number of figures tested. ``false_match_probability``: bound for the identification in ``row``,
    NaN if there is none."""

    mode: Mode
    method: str
    unit_cam: Array
    row: Rows
    selected: Rows
    weight: Array
    operations: int
    figures: int
    false_match_probability: float
    reason: str

    @property
    def confidence(self) -> float:
        """Return the share of identified centroids among those used; 0 without a result."""
        return len(self.selected) / len(self.row) if len(self.row) else 0.0


@dataclass
class _FrameSearch:
    """State of the search on one frame: inputs, best result, and counters of the work."""

    unit: Array
    sigma_rad: Array
    camera: Camera
    catalogue: FarMstCatalogue
    p: FarMstParameters
    mode: Mode
    hint: AttitudePrior | None
    table: Baselines | None = None
    figures: int = 0
    best: Identified | None = None
    best_bound: float = float("nan")
    method: str = ""

    @property
    def hits(self) -> int:
        return self.table.hits if self.table is not None else 0


def match_stars(
    centroids: Centroids,
    camera: Camera,
    catalogue: FarMstCatalogue,
    parameters: FarMstParameters,
    mode: Mode = Mode.LOST_IN_SPACE,
    hint: AttitudePrior | None = None,
) -> FarMstMatching:
    """Identify centroids. Only the first ``max_centroids`` are used."""
    check_hint(mode, hint)
    used = centroids.take(np.arange(min(len(centroids), parameters.max_centroids)))
    unit = camera.unproject(used.pixels) if len(used) else np.empty((0, 3))
    # A centroid outside the domain of the distortion has no direction. It remains in the arrays but is not used.
    good = np.flatnonzero(np.isfinite(unit).all(axis=1))
    sigma_rad = np.maximum(used.sigma_px[good], 1e-3) * camera.pixel_rad
    search = _FrameSearch(unit[good], sigma_rad, camera, catalogue, parameters, mode, hint)
    accepted = mode is Mode.TRACKING and _track(search)
    if not accepted and len(good) >= 3:
        accepted = _find_figures(search)
    return _matching(search, used, unit, good, accepted)


def _find_figures(s: _FrameSearch) -> bool:
    """Search with n-vertex or pyramid over the directory. With a hint, only stars near it are searched."""
    n = min(len(s.unit), s.p.max_vertex_stars)
    tolerance = pair_tolerance_rad(s.sigma_rad[:n], s.camera.pixel_rad, s.p)
    s.table = baselines(s.unit[:n], tolerance, _directory(s))
    for tried, (method, figure, names) in enumerate(_hypotheses(s, n)):
        if s.p.acceptance == "document":
            s.best, s.method = _figure_only(s, figure, names), method
            return True
        if tried >= s.p.most_hypotheses:
            break
        completed = complete(s.unit, s.sigma_rad, figure, names, s.catalogue, s.camera, s.p)
        if completed is None:
            continue
        if _accept(s, completed, method, _lost_hypotheses(s)):
            return not _off_hint(s, completed)
    return False


def _hypotheses(s: _FrameSearch, n: int) -> Iterator[tuple[str, Rows, Rows]]:
    """Yield the identified figures of all matchers, in the order of the matchers."""
    if s.table is None:
        return
    icrs, document = s.catalogue.icrs, s.p.acceptance == "document"
    if s.p.matcher == "pyramid":
        for pyramid in pyramids(s.unit[:n], icrs, s.table, s.p.most_figures[0]):
            yield "pyramid", np.array(pyramid.figure), pyramid.names
        return
    if s.p.matcher == "pivot":
        yield from _pivoted(s, n)
        return
    for vertices in _vertices(s.p.matcher, n):
        for figure in figures(n, vertices)[: s.p.most_figures[vertices - 3]]:
            s.figures += 1
            names = match_figure(figure, s.table, s.unit, icrs)
            if document and len(names) != 1:
                continue
            for stars in names[:MAX_NAMES_PER_FIGURE]:
                yield f"{vertices}-vertex", np.array(figure), stars


def _pivoted(s: _FrameSearch, n: int) -> Iterator[tuple[str, Rows, Rows]]:
    """Yield the solutions of pivoting. The document accepts a single solution only."""
    assert s.table is not None  # noqa: S101 - the caller has built the table
    for order in islice(pivot_orders(n), s.p.most_figures[0]):
        s.figures += 1
        figure, names = pivoted(order, s.table)
        if s.p.acceptance == "document" and len(names) != 1:
            continue
        for stars in same_handed(names, figure, s.unit, s.catalogue.icrs)[:MAX_NAMES_PER_FIGURE]:
            yield "pivoting", np.array(figure), stars


def _vertices(matcher: str, n: int) -> tuple[int, ...]:
    counts = {"auto": (5, 4, 3), "n5": (5,), "n4": (4,), "n3": (3,)}[matcher]
    return tuple(v for v in counts if v <= n)


def _directory(s: _FrameSearch) -> Sin2Directory:
    """Return the directory, or the part of it near the hint."""
    if s.mode is Mode.LOST_IN_SPACE or s.hint is None:
        return s.catalogue.directory
    cosine = s.catalogue.icrs @ _expected(s.hint, s.mode).boresight_icrs
    return s.catalogue.directory.restricted(cosine >= np.cos(s.p.assisted_radius_rad))


def _lost_hypotheses(s: _FrameSearch) -> float:
    """Return the number of hypotheses: two per matching directory entry, reduced by a hint to the share of boresights
    that it allows."""
    ways = 2.0 * max(1, s.hits)
    if s.mode is Mode.ASSISTED:
        ways *= (1 - np.cos(_hint_error_rad(s))) / (1 - np.cos(s.p.assisted_radius_rad))
    return float(ways)


def _hint_error_rad(s: _FrameSearch) -> float:
    return hint_error_rad(s.camera, s.p.assisted_radius_rad, HINT_ERROR_RAD)


def _accept(s: _FrameSearch, candidate: Identified, method: str, hypotheses: float) -> bool:
    """True if enough stars are identified, an accidental match is unlikely and the rest of the field does not
    contradict it. The best result is stored for the reason text."""
    bound = candidate.bound(hypotheses)
    if s.best is None or candidate.count > s.best.count:
        s.best, s.best_bound, s.method = candidate, bound, method
    if candidate.count < _min_verified(s) or bound > s.p.max_false_probability or candidate.share < s.p.min_share:
        return False
    s.best, s.best_bound, s.method = candidate, bound, method
    return True


def _min_verified(s: _FrameSearch) -> int:
    return s.p.min_identified[ORDER.index(s.mode)]


def _off_hint(s: _FrameSearch, candidate: Identified) -> bool:
    if s.mode is Mode.LOST_IN_SPACE or s.hint is None:
        return False
    return off_hint(_expected(s.hint, s.mode), candidate.cam_from_icrs, _hint_error_rad(s)) != ""


def _figure_only(s: _FrameSearch, figure: Rows, names: Rows) -> Identified:
    """Return the result as in the document, with only the stars of the figure."""
    row = np.full(len(s.unit), -1, np.intp)
    row[figure] = names
    return Identified(row, len(figure), len(figure), len(figure), np.eye(3), float("nan"), float("nan"))


def _track(s: _FrameSearch) -> bool:
    """Run the rate match with the catalogue. Stars are predicted at a constant rate, and also without rotation, because
    the rotation can have stopped."""
    predictions = _predictions(s.hint)
    for rotation in predictions:
        in_view = stars_in_view(s.catalogue.icrs, rotation, s.camera)
        pairs = mutual_nearest(s.catalogue.icrs[in_view] @ rotation.T, s.unit, s.p.tracking_radius_rad)
        names, matched = in_view[pairs[:, 0]], pairs[:, 1]
        chosen = _agreeing(s, matched, names)
        if len(chosen) < 2:
            continue
        completed = complete(s.unit, s.sigma_rad, matched[chosen], names[chosen], s.catalogue, s.camera, s.p)
        if completed is None:
            continue
        tolerance = float(pair_tolerance_rad(s.sigma_rad, s.camera.pixel_rad, s.p).max())
        ways = tracking_hypotheses(len(s.unit), completed.per_sr, tolerance, s.p.tracking_radius_rad)
        if _accept(s, completed, "rate match", len(predictions) * ways):
            return True
    return False


def _predictions(hint: AttitudePrior | None) -> list[Array]:
    """Return the expected (3, 3) attitudes: extrapolated at the rate of the last interval, if known, and unchanged."""
    if hint is None or hint.quaternion is None:
        return []
    still = [matrix_from_quaternion(hint.quaternion)]
    return [extrapolate(hint.quaternion, hint.earlier[0], hint.steps), *still] if hint.earlier else still


def _expected(hint: AttitudePrior, mode: Mode) -> AttitudePrior:
    """Return the hint, in tracking extrapolated at constant rate. The boresight is a unit vector."""
    if mode is Mode.TRACKING and hint.quaternion is not None:
        return AttitudePrior.from_quaternion(quaternion_from_matrix(_predictions(hint)[0]))
    boresight = np.asarray(hint.boresight_icrs, float)
    return replace(hint, boresight_icrs=boresight / np.linalg.norm(boresight))


def _agreeing(s: _FrameSearch, matched: Rows, names: Rows) -> Rows:
    """Return the indices of the pairs whose angles all agree with the catalogue."""
    off = np.abs(angle_matrix_rad(s.unit[matched]) - angle_matrix_rad(s.catalogue.icrs[names]))
    agree = (off <= pair_tolerance_rad(s.sigma_rad[matched], s.camera.pixel_rad, s.p)).astype(np.int64)
    np.fill_diagonal(agree, 0)
    friends = agree.sum(axis=1)
    return mutually_consistent(agree, np.flatnonzero(friends >= 1))


def _matching(s: _FrameSearch, used: Centroids, unit: Array, good: Rows, accepted: bool) -> FarMstMatching:
    row = np.full(len(unit), -1, np.intp)
    weight: NDArray[np.float64] = 1.0 / np.maximum(used.sigma_px, 1e-3) ** 2
    if s.best is not None:
        row[good] = s.best.row
    selected = np.flatnonzero(row >= 0) if accepted else NONE
    return FarMstMatching(
        s.mode, s.method, unit, row, selected, weight, s.hits, s.figures, s.best_bound, "" if accepted else _reason(s)
    )


def _reason(s: _FrameSearch) -> str:
    n, needed, mode = len(s.unit), _min_verified(s), s.mode.value.replace("_", " ")
    if n == 0:
        return "no star found in the frame"
    if n < needed or (n < 3 and s.best is None):
        return f"{n} {'star' if n == 1 else 'stars'} found; {needed} needed in {mode} mode"
    if s.best is None:
        return f"no figure of the {n} stars fits the catalogue"
    if s.best.count < needed:
        return f"{s.best.count} of {n} stars identified; {needed} needed in {mode} mode"
    if s.best.share < s.p.min_share:
        return f"only {s.best.count} of {n} stars identified, although the catalogue has {s.best.in_view} in this field"
    if s.best_bound <= s.p.max_false_probability:
        return "the stars fit only far from the hint"
    return (
        f"{s.best.count} of {n} stars identified could be accidental: bound {s.best_bound:.1e}, "
        f"allowed {s.p.max_false_probability:.0e}"
    )
