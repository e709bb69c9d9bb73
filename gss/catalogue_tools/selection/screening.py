"""Probability of confusing a star with another star, computed from the star density (Moniteq 1983 §2.1), and the stars
that Moniteq's list omits or flags (Table 2.4)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from gss.domain.angles import Array
from gss.domain.errors import BadInput
from gss.domain.stars import FLAG_MULTIPLE, FLAG_VARIABLE, StarTable

# Error of the magnitude, error of the separation, and arc in the example of Moniteq 1983 §2.1.
MONITEQ_MAG, MONITEQ_RAD, MONITEQ_ARC_RAD = 0.5, float(np.radians(0.01)), float(np.radians(8.0))
# Table 2.4: proper motion above 1″ a year; bright pairs are mostly closer than 30″ (§2.2).
FAST_RAD_YR = float(np.radians(1 / 3600))
DOUBLE_RAD = float(np.radians(30 / 3600))
ACTIONS = ("drop", "list")


@dataclass(frozen=True)
class FalseMatches:
    """Expected numbers of stars that match by chance, and the Poisson probability of exactly one such star. The
    document states the probability.

    ``second``: expected number in the ring at the arc from a star. ``third``: expected number in the patch in which a
    third star would match two stars. ``joint_probability``: probability of both, for three stars of one field.
    """

    density_per_sr: float
    second: float
    third: float

    @property
    def second_probability(self) -> float:
        """Probability of one star in the ring."""
        return _one(self.second)

    @property
    def third_probability(self) -> float:
        """Probability of one star in the patch."""
        return _one(self.third)

    @property
    def joint_probability(self) -> float:
        """Probability of a second and a third star by chance."""
        return self.second_probability * self.third_probability


def false_matches(
    v_mag: Array,
    at_mag: float | None = None,
    tolerance_mag: float = MONITEQ_MAG,
    tolerance_rad: float = MONITEQ_RAD,
    arc_rad: float = MONITEQ_ARC_RAD,
    area_sr: float = 4 * np.pi,
) -> FalseMatches:
    """Compute the chance companions in a catalogue of (n,) magnitudes spread over ``area_sr``.

    ``at_mag``: count stars within ± ``tolerance_mag`` of this magnitude; None: count the whole catalogue, as for the
    document's value of 0.17. The ring of half width δ at arc ρ has the solid angle 4π·sin ρ·sin δ (4πρδ in the
    document, 0.3 % more at 8°), and the patch has 2π(1 − cos δ).
    """
    bad = not (tolerance_mag > 0 and 0 < tolerance_rad < np.pi / 2 and 0 < arc_rad < np.pi and 0 < area_sr <= 4 * np.pi)
    if bad:
        raise BadInput(
            "a tolerance, the arc or the area is out of range",
            expected="all above 0, arc below 180°, area at most the sphere",
            got=f"{tolerance_mag:g} mag, {tolerance_rad:g} rad, {arc_rad:g} rad, {area_sr:g} sr",
        )
    magnitudes = np.asarray(v_mag, float)
    counted = len(magnitudes) if at_mag is None else np.count_nonzero(np.abs(magnitudes - at_mag) <= tolerance_mag)
    density = float(counted / area_sr)
    ring = 4 * np.pi * np.sin(arc_rad) * np.sin(tolerance_rad)
    patch = 2 * np.pi * (1 - np.cos(tolerance_rad))
    return FalseMatches(density, float(density * ring), float(density * patch))


def companions(
    unit: Array, v_mag: Array, arc_rad: float, tolerance_rad: float, at_mag: float, tolerance_mag: float
) -> Array:
    """Return the (n,) actual number of stars within ± ``tolerance_mag`` of ``at_mag`` in the ring around each of (n, 3)
    stars. In contrast, :func:`false_matches` assumes a uniform density."""
    similar = unit[np.abs(np.asarray(v_mag) - at_mag) <= tolerance_mag]
    if not len(similar) or not len(unit):
        return np.zeros(len(unit))
    tree = cKDTree(similar)
    near, far = (2 * np.sin(np.clip(arc_rad + s * tolerance_rad, 0, np.pi) / 2) for s in (-1, 1))
    outer, inner = (tree.query_ball_point(unit, radius, return_length=True) for radius in (far, near))
    return np.asarray(outer - inner, float)


@dataclass(frozen=True)
class ScreeningRules:
    """Criteria of the screening list. ``action``: drop removes a listed star, list only reports it.

    ``doubles``, ``variables``, ``fast``: True to list the stars that :func:`screen` marks for this reason.
    ``most_companions``: a star is listed if it has more stars than this in the ring at ``arc_rad`` ± ``tolerance_rad``,
    regardless of their magnitude. ``most_false``: limit on the expected number of false triples, which is the number of
    stars in the ring times the expected number of chance stars in the patch of a third star. None: not checked.
    """

    action: str = "drop"
    doubles: bool = True
    variables: bool = True
    fast: bool = True
    most_companions: int | None = None
    most_false: float | None = None
    arc_rad: float = MONITEQ_ARC_RAD
    tolerance_rad: float = MONITEQ_RAD
    double_rad: float = DOUBLE_RAD
    fast_rad_yr: float = FAST_RAD_YR

    def __post_init__(self) -> None:
        if self.action not in ACTIONS:
            raise BadInput("unknown screening", expected=" | ".join(ACTIONS), got=self.action)
        limits = (self.most_companions, self.most_false)
        if any(limit is not None and not (np.isfinite(limit) and limit >= 0) for limit in limits):
            raise BadInput("a limit of the screening is out of range", expected="0 or more", got=str(limits))
        if not (0 < self.tolerance_rad < np.pi / 2 and 0 < self.arc_rad < np.pi):
            raise BadInput(
                "the ring of the screening is out of range",
                expected="an arc of 0° to 180°, a tolerance of 0° to 90°",
                got=f"{np.degrees(self.arc_rad):g}° ± {np.degrees(self.tolerance_rad):g}°",
            )


@dataclass(frozen=True)
class ScreenedStars:
    """Result of the screening: (n,) masks by reason and (n,) numbers of companions. ``third``: see
    :class:`FalseMatches`."""

    reasons: dict[str, NDArray[np.bool_]]
    companions: Array
    third: float

    @property
    def marked(self) -> NDArray[np.bool_]:
        """(n,) mask of stars with any reason."""
        return np.asarray(np.any(list(self.reasons.values()), axis=0))

    @property
    def counts(self) -> dict[str, int]:
        """Number of stars by reason. A star can have several reasons."""
        named = {name: int(np.count_nonzero(mask)) for name, mask in self.reasons.items()}
        return named | {"any": int(np.count_nonzero(self.marked))}


def screened(stars: StarTable, on_board: NDArray[np.bool_], rules: ScreeningRules) -> ScreenedStars:
    """Screen (n,) stars.

    ``on_board``: mask of the stars permitted on board; only these can be confused. The chance of a third star is
    computed from the number of all stars on the sphere.
    """
    marks = screen(stars, rules.double_rad, rules.fast_rad_yr)
    ring = companions(stars.icrs, np.where(on_board, 0.0, np.nan), rules.arc_rad, rules.tolerance_rad, 0.0, 1.0)
    third = false_matches(stars.v_mag, None, MONITEQ_MAG, rules.tolerance_rad, rules.arc_rad).third
    reasons = {
        name: mask
        for name, mask in (("double", marks.double), ("variable", marks.variable), ("fast", marks.fast))
        if getattr(rules, {"double": "doubles", "variable": "variables", "fast": "fast"}[name])
    }
    if rules.most_companions is not None:
        reasons["companions"] = ring > rules.most_companions
    if rules.most_false is not None:
        reasons["false matches"] = ring * third > rules.most_false
    return ScreenedStars(reasons or {"none": np.zeros(len(stars), bool)}, ring, third)


@dataclass(frozen=True)
class Screening:
    """(n,) marks of Moniteq's screening (§2.2, §2.3, Table 2.4)."""

    double: NDArray[np.bool_]
    variable: NDArray[np.bool_]
    fast: NDArray[np.bool_]

    @property
    def marked(self) -> NDArray[np.bool_]:
        """(n,) mask of stars with any mark."""
        return self.double | self.variable | self.fast

    @property
    def counts(self) -> dict[str, int]:
        """Number of stars by reason. A star can have several reasons."""
        named = {"double": self.double, "variable": self.variable, "fast": self.fast, "any": self.marked}
        return {name: int(np.count_nonzero(mask)) for name, mask in named.items()}


def screen(stars: StarTable, double_rad: float = DOUBLE_RAD, fast_rad_yr: float = FAST_RAD_YR) -> Screening:
    """Mark doubles, variables, and stars with fast proper motion. A star is a double if it has a neighbour closer than
    ``double_rad`` in the table or is flagged as multiple."""
    if not (0 <= double_rad < np.pi and fast_rad_yr > 0):
        raise BadInput("screening limits are out of range", expected="separation 0 to 180°, motion above 0")
    close = np.zeros(len(stars), bool)
    if double_rad > 0 and len(stars) > 1:
        close[cKDTree(stars.icrs).query_pairs(2 * np.sin(double_rad / 2), output_type="ndarray").ravel()] = True
    moving = np.linalg.norm(stars.proper_motion_rad_yr, axis=1) > fast_rad_yr
    return Screening(close | ((stars.flags & FLAG_MULTIPLE) > 0), (stars.flags & FLAG_VARIABLE) > 0, moving)


def _one(mean: float) -> float:
    return float(mean * np.exp(-mean))
