"""Select the stars of the envelope to store on board, and record the reason for each rejection."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from typing_extensions import TypedDict  # pydantic needs this one before Python 3.12

from gss.catalogue_tools.envelope.envelope import Envelope
from gss.catalogue_tools.envelope.field import FieldShape
from gss.catalogue_tools.envelope.healpix import centres
from gss.catalogue_tools.selection.screening import ScreenedStars, ScreeningRules, screened
from gss.catalogue_tools.selection.uniform_density import looks, reduce_catalogue, survey_attitudes
from gss.catalogue_tools.sources.hipparcos import HIP2_STARS
from gss.domain.angles import Array
from gss.domain.callbacks import no_progress
from gss.domain.errors import BadInput
from gss.domain.stars import FLAG_VARIABLE, StarTable

# Difference of magnitude for which a fainter neighbour shifts the common centroid by less than a tenth of the
# separation.
HARMLESS_DIFFERENCE_MAG = 2.5
MAX_LISTED = 500
# Thinning methods, with the name of their fields in the funnel.
THINNINGS = {"circles": "field", "frames": "upright frame"}
# Step between frames: an eighth of the field's shorter side, within limits.
FRAME_STEP, FRAME_STEPS_RAD = 1 / 8, (float(np.radians(0.5)), float(np.radians(4.0)))


class Fate(IntEnum):
    """Result of the selection for a star within the magnitude limit. If several reasons apply, the first reason is
    used."""

    KEPT = 0
    OUTSIDE = 1
    DOUBLE = 2
    VARIABLE = 3
    TOO_BRIGHT = 4
    THINNED = 5
    # This reason is applied before the thinning. It has the last number because it was added later.
    SCREENED = 6

    @property
    def map_state(self) -> str:
        """State shown on the map: kept, thinned, rejected or outside."""
        return {Fate.KEPT: "kept", Fate.OUTSIDE: "outside", Fate.THINNED: "thinned"}.get(self, "rejected")


@dataclass(frozen=True)
class SelectionRules:
    """Selection rules: limits in V, smallest separation of two usable stars, number of brightest stars per field (0 =
    all).

    ``thinning``: type of the fields. circles: circles as large as the camera's field, densely spaced over the envelope.
    frames: upright frames of the camera's shape, evenly spaced over the sky (Huffman 2006 §5.5.4). ``screening`` None:
    no screening list.
    """

    faint_mag: float
    bright_mag: float = -2.0
    min_separation_rad: float = 0.0
    brightest_per_field: int = 0
    drop_variables: bool = False
    thinning: str = "circles"
    screening: ScreeningRules | None = None

    def __post_init__(self) -> None:
        numbers = (self.faint_mag, self.bright_mag, self.min_separation_rad)
        if not all(np.isfinite(n) for n in numbers):
            raise BadInput("a selection limit is not a number", expected="finite limits", got=str(numbers))
        if self.bright_mag >= self.faint_mag:
            raise BadInput(
                "the bright limit is not brighter than the faint limit",
                expected=f"below {self.faint_mag:g}",
                got=f"{self.bright_mag:g}",
            )
        if not 0 <= self.min_separation_rad < np.pi or self.brightest_per_field < 0:
            raise BadInput("separation and stars per field cannot be negative", expected="0 or more")
        if self.thinning not in THINNINGS:
            raise BadInput("unknown thinning method", expected=" | ".join(THINNINGS), got=self.thinning)


@dataclass(frozen=True)
class FunnelStep:
    """One line of the funnel of counts. ``dropped``: True if the line counts removed stars, False if it counts
    remaining stars."""

    label: str
    stars: int
    dropped: bool


@dataclass(frozen=True)
class Selection:
    """Result of a selection.

    ``candidates``: all stars within the faint limit, brightest first. ``fate``: (n,) Fate of each candidate.
    ``source``, ``source_stars``: name and size of the source catalogue. ``blends``: number of stars removed before the
    selection because their images blend. ``screened``: screening result for the candidates, None without screening.
    """

    candidates: StarTable
    fate: NDArray[np.int8]
    rules: SelectionRules
    source: str = "Hipparcos"
    source_stars: int = HIP2_STARS
    blends: int = 0
    screened: ScreenedStars | None = None

    def from_source(self, source: str, stars: int, blends: int) -> Selection:
        """Return the same selection with the name and size of its source catalogue."""
        return replace(self, source=source, source_stars=stars, blends=blends)

    @property
    def kept(self) -> StarTable:
        """The stars to store on board, brightest first."""
        return self.candidates.take(self.fate == Fate.KEPT)

    def count(self, fate: Fate) -> int:
        """Return the number of stars with this fate."""
        return int(np.count_nonzero(self.fate == fate))

    @property
    def funnel(self) -> tuple[FunnelStep, ...]:
        """Counts from the source to the bank."""
        n, rules = len(self.candidates), self.rules
        screening = self.rules.screening
        dropped: tuple[FunnelStep, ...] = ()
        listed: tuple[FunnelStep, ...] = ()
        if screening is not None and screening.action == "drop":
            dropped = (FunnelStep("on the screening list", self.count(Fate.SCREENED), True),)
        elif self.screened is not None:
            kept_marked = int(np.count_nonzero(self.screened.marked & (self.fate == Fate.KEPT)))
            listed = (FunnelStep("of these on the screening list", kept_marked, False),)
        thinned = f"beyond {rules.brightest_per_field} per {THINNINGS[rules.thinning]}"
        blends = (FunnelStep("blends rejected", self.blends, True),) if self.blends else ()
        return (
            FunnelStep(self.source, self.source_stars, False),
            *blends,
            FunnelStep(f"V ≤ {rules.faint_mag:.2f}", n, False),
            FunnelStep("inside the envelope", n - self.count(Fate.OUTSIDE), False),
            FunnelStep("close doubles", self.count(Fate.DOUBLE), True),
            FunnelStep("variable", self.count(Fate.VARIABLE), True),
            FunnelStep("too bright", self.count(Fate.TOO_BRIGHT), True),
            *dropped,
            FunnelStep(thinned if rules.brightest_per_field else "thinned", self.count(Fate.THINNED), True),
            FunnelStep("kept", self.count(Fate.KEPT), False),
            *listed,
        )


class ListedStar(TypedDict):
    """A star that the screening marked."""

    hip: int
    reasons: list[str]
    companions: int
    kept: bool


class ScreeningFacts(TypedDict):
    """Stars that the screening marked. ``counts``: number of stars by reason. ``third``: mean number of stars in the
    patch in which a third star would match two stars."""

    action: str
    counts: dict[str, int]
    mean_companions: float
    most_companions: float
    third: float
    stars: list[ListedStar]


def screening_facts(selection: Selection) -> ScreeningFacts | None:
    """Return, as plain values, the counts by reason over the stars in the envelope, and the listed stars, brightest
    first; None without screening."""
    rules, screened = selection.rules.screening, selection.screened
    if rules is None or screened is None:
        return None
    covered = selection.fate != Fate.OUTSIDE
    listed = np.flatnonzero(screened.marked & covered)
    inside = {name: int(np.count_nonzero(mask & covered)) for name, mask in screened.reasons.items()}
    return {
        "action": rules.action,
        "counts": inside | {"any": len(listed)},
        "mean_companions": float(screened.companions[covered].mean()) if covered.any() else 0.0,
        "most_companions": float(screened.companions[covered].max(initial=0.0)),
        "third": screened.third,
        "stars": [
            {
                "hip": int(selection.candidates.hip[k]),
                "reasons": [name for name, mask in screened.reasons.items() if mask[k]],
                "companions": int(screened.companions[k]),
                "kept": bool(selection.fate[k] == Fate.KEPT),
            }
            for k in listed[:MAX_LISTED]
        ],
    }


def select(
    stars: StarTable,
    envelope: Envelope,
    rules: SelectionRules,
    shape: FieldShape,
    report: Callable[[float], None] = no_progress,
) -> Selection:
    """Apply the rules to ``stars``. Raises BadInput if the star table is not valid or no star is within the limit.

    ``shape``: field of view for the thinning. ``report`` is called with the fraction of frames done during a thinning
    by frames. It can raise an exception to cancel.
    """
    _check_stars(stars)
    candidates = stars.brighter_than(rules.faint_mag)
    if not len(candidates):
        raise BadInput(
            "the magnitude limit leaves no stars",
            expected=f"V ≥ {stars.v_mag.min():g}" if len(stars) else "a star table",
            got=f"{rules.faint_mag:g}",
        )
    fate = np.zeros(len(candidates), np.int8)
    fate[~envelope.contains(candidates.icrs)] = Fate.OUTSIDE
    _mark(fate, _merging(candidates, rules.min_separation_rad), Fate.DOUBLE)
    if rules.drop_variables:
        _mark(fate, (candidates.flags & FLAG_VARIABLE) > 0, Fate.VARIABLE)
    _mark(fate, candidates.v_mag < rules.bright_mag, Fate.TOO_BRIGHT)
    screening = None
    if rules.screening is not None:
        screening = screened(candidates, fate != Fate.OUTSIDE, rules.screening)
        if rules.screening.action == "drop":
            _mark(fate, screening.marked, Fate.SCREENED)
    if rules.brightest_per_field:
        usable = np.flatnonzero(fate == Fate.KEPT)
        if rules.thinning == "frames":
            in_frames = _in_frames(candidates.take(usable), envelope, rules.brightest_per_field, shape, report)
        else:
            in_frames = _brightest(candidates.icrs[usable], envelope, rules.brightest_per_field, shape.equal_circle_rad)
        fate[usable[~in_frames]] = Fate.THINNED
    return Selection(candidates, fate, rules, screened=screening)


def _mark(fate: NDArray[np.int8], which: NDArray[np.bool_], value: Fate) -> None:
    fate[which & (fate == Fate.KEPT)] = value


def _merging(stars: StarTable, separation_rad: float) -> NDArray[np.bool_]:
    """Return the (n,) mask of stars whose image merges with that of a neighbour. In a close pair, the fainter star is
    marked. The brighter star is also marked, unless the fainter star is harmless.

    Neighbours beyond the faint limit are not considered.
    """
    spoiled = np.zeros(len(stars), bool)
    if separation_rad <= 0 or len(stars) < 2:
        return spoiled
    pairs = cKDTree(stars.icrs).query_pairs(2 * np.sin(separation_rad / 2), output_type="ndarray")
    bright, faint = pairs.min(axis=1), pairs.max(axis=1)
    spoiled[faint] = True
    spoiled[bright[stars.v_mag[faint] - stars.v_mag[bright] < HARMLESS_DIFFERENCE_MAG]] = True
    return spoiled


def _brightest(unit: Array, envelope: Envelope, count: int, radius_rad: float) -> NDArray[np.bool_]:
    """Return the (n,) mask of stars that are among the ``count`` brightest of some field. Stars are sorted by
    brightness. Fields are circles on a grid of equal-area pixels within the envelope (after Huffman 2006 §5.5.4: the
    brightest of every field).

    The search starts with the brightest stars. For fields that have too few of these, fainter stars are searched too.
    """
    selected = np.zeros(len(unit), bool)
    grid = centres(_grid_nside(radius_rad))
    pointings = grid[envelope.contains(grid)]
    circle_share = (1 - np.cos(radius_rad)) / 2
    depth = int(4 * count / circle_share)
    while len(pointings) and len(unit):
        tree = cKDTree(unit[:depth])
        in_field = tree.query_ball_point(pointings, 2 * np.sin(radius_rad / 2), return_sorted=True)
        filled = np.array([len(inside) >= count for inside in in_field])
        for inside in in_field:
            selected[inside[:count]] = True
        if depth >= len(unit):
            break
        pointings, depth = pointings[~filled], 4 * depth
    return selected


def frame_looks(stars: int, rules: SelectionRules, shape: FieldShape) -> float:
    """Estimate how many times a thinning by frames over the whole sky tests a star; 0 for other thinnings."""
    if rules.thinning != "frames" or not rules.brightest_per_field:
        return 0.0
    return looks(stars, shape, round(4 * np.pi / _frame_step_rad(shape) ** 2), rules.brightest_per_field)


def _frame_step_rad(shape: FieldShape) -> float:
    return float(np.clip(FRAME_STEP * min(shape.camera.fov_rad), *FRAME_STEPS_RAD))


def _in_frames(
    stars: StarTable, envelope: Envelope, count: int, shape: FieldShape, report: Callable[[float], None]
) -> NDArray[np.bool_]:
    """Return the (n,) mask of stars that are among the ``count`` brightest of some upright frame. Frames have the shape
    of the field and their boresight in the envelope (Huffman 2006 §5.5.4, with steps of 1° for a frame of about
    36°)."""
    attitudes = survey_attitudes(_frame_step_rad(shape))
    inside = attitudes[envelope.contains(attitudes[:, 2])]
    if not len(inside) or not len(stars):
        return np.zeros(len(stars), bool)
    return reduce_catalogue(stars, shape, inside, count, report).kept


def _grid_nside(radius_rad: float) -> int:
    """Return the HEALPix resolution at which pixels are not larger than half the radius of a field, within limits."""
    min_nside = np.sqrt(np.pi / 3) / (radius_rad / 2)
    return int(np.clip(2 ** np.ceil(np.log2(min_nside)), 4, 64))


def _check_stars(stars: StarTable) -> None:
    """Raise BadInput if a star table has non-finite values or repeated numbers. Tables from other sources can have such
    rows."""
    bad = ~(np.isfinite(stars.icrs).all(axis=1) & np.isfinite(stars.v_mag))
    if bad.any():
        raise BadInput(
            "the star table has rows that are not numbers",
            expected="finite positions and V",
            got=f"HIP {stars.hip[bad][0]}",
        )
    values, counts = np.unique(stars.hip, return_counts=True)
    if (counts > 1).any():
        raise BadInput(
            "the star table contains a star twice", expected="each number once", got=f"HIP {values[counts > 1][0]}"
        )
