"""Assessment of the heads of one spacecraft: agreement, misalignment and drift compared with limits, as text."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from gss.domain.angles import ARCSEC_RAD, Array
from gss.domain.limits import State
from gss.operations.heads.mountings import HOUR_S, Source, SpacecraftSetup
from gss.operations.heads.tracker import HeadTracker, PairResult

UNLIKELY = 1e-5
"""Probability below which a difference between heads is inconsistent with the stated covariances."""
RAISED_AFTER, CLEARED_AFTER = 3, 10
"""Number of consecutive inconsistent comparisons that raises the agreement alarm, and number of consecutive consistent
comparisons that clears it."""
FROM: Mapping[Source, str] = {"on board": "from its sensor", "ground": "solved on the ground"}
SIGNIFICANT = 3.0
"""Number of standard deviations by which a misalignment or drift must exceed its limit to raise an alarm."""


@dataclass(frozen=True)
class HeadsVerdict:
    """Agreement of the heads. ``state`` is None if the heads cannot be compared; ``text`` then states the reason."""

    state: State | None
    text: str


@dataclass(frozen=True)
class HeadsFinding:
    """State of one alarm condition. ``value``: the compared value (χ², or an angle in ″ or ″/h). ``limit``: description of the
    violated limit."""

    name: str
    state: State
    value: float
    text: str
    limit: str


def verdict(tracker: HeadTracker, disagreeing: bool, now_s: float) -> HeadsVerdict:
    """Return the current agreement of the heads."""
    setup, result = tracker.setup, tracker.result
    fresh = [head.unit for head in setup.heads if tracker.is_fresh(head.unit, now_s)]
    if not fresh:
        ages_s = [age_s for head in setup.heads if (age_s := tracker.age_s(head.unit, now_s)) is not None]
        newest = f"; the latest is {min(ages_s):.0f} s old" if ages_s else ""
        return HeadsVerdict(
            None, f"No head has an attitude {FROM[setup.source]} of the last {setup.stale_s:g} s{newest}."
        )
    if len(fresh) == 1:
        silent = ", ".join(head.unit for head in setup.heads if head.unit not in fresh)
        alone = f"Only {fresh[0]} reports; {silent} {'is' if silent.count(',') == 0 else 'are'} silent."
        return HeadsVerdict(None, alone if silent else f"{fresh[0]} is the only head.")
    if result is None or now_s - result.time_s > 2 * setup.stale_s:
        lacks = _listed({unit: lack for unit in fresh if (lack := tracker.lacks(unit))})
        reasons = lacks or "no attitudes of several heads at one time were received"
        return HeadsVerdict(None, f"The attitudes cannot be compared. {reasons}.")
    if result.fused.agreement is None:
        return HeadsVerdict(None, f"Only one head could be used. {_listed(result.missing)}.")
    agreement = result.fused.agreement
    figures = f"χ² {agreement.chi2:.1f} with {agreement.freedom} degrees of freedom"
    if disagreeing:
        return HeadsVerdict(State.WARNING, f"{_apart(result.pairs)}: {figures}.")
    return HeadsVerdict(State.OK, f"The heads agree: {figures}.")


class AgreementWatch:
    """Decides from successive comparisons whether the heads disagree."""

    def __init__(self) -> None:
        self.disagreeing = False
        self._against = 0

    def take(self, probability: float | None) -> None:
        """Add the probability of one comparison. None, a comparison without a probability, is ignored."""
        if probability is None:
            return
        unlikely = probability < UNLIKELY
        self._against = self._against + 1 if unlikely is not self.disagreeing else 0
        if self._against >= (CLEARED_AFTER if self.disagreeing else RAISED_AFTER):
            self.disagreeing, self._against = not self.disagreeing, 0


def findings(setup: SpacecraftSetup, disagreeing: bool, pairs: Sequence[PairResult], chi2: float) -> list[HeadsFinding]:
    """Return the states of a spacecraft's alarm conditions after a comparison of at least two heads."""
    disagreement = _apart(pairs)
    result = [
        HeadsFinding(
            f"{setup.name}: agreement",
            State.WARNING if disagreeing else State.OK,
            round(chi2, 1),
            f"{setup.name}: {disagreement}",
            f"{disagreement}, probability below {UNLIKELY:g}",
        )
    ]
    for pair in pairs:
        misalignment = pair.misalignment
        name = f"{setup.name}: {pair.unit}"
        if setup.misalignment_limit_rad is not None:
            limit = setup.misalignment_limit_rad / ARCSEC_RAD
            size, sigma = _size(misalignment.vector_rad / ARCSEC_RAD, pair.sigma_rad / ARCSEC_RAD)
            text = f"{pair.unit} is misaligned by {size:.1f}″ ± {sigma:.1f}″ against {pair.reference}"
            result.append(_against(f"{name} misalignment", State.WARNING, size, sigma, text, limit, "″"))
        if setup.drift_limit_rad_s is not None:
            limit = setup.drift_limit_rad_s / ARCSEC_RAD * HOUR_S
            scale = HOUR_S / ARCSEC_RAD
            size, sigma = _size(misalignment.drift_rad_s * scale, pair.drift_sigma_rad_s * scale)
            text = f"{pair.unit} drifts by {size:.1f}″/h ± {sigma:.1f}″/h against {pair.reference}"
            result.append(_against(f"{name} drift", State.WATCH, size, sigma, text, limit, "″/h"))
    return result


def _against(name: str, level: State, size: float, sigma: float, text: str, limit: float, unit: str) -> HeadsFinding:
    beyond = size - SIGNIFICANT * sigma > limit
    return HeadsFinding(name, level if beyond else State.OK, round(size, 1), text, f"{text}, above {limit:g}{unit}")


def _listed(reasons: Mapping[str, str]) -> str:
    return "; ".join(f"{unit}: {reason}" for unit, reason in reasons.items())


def _size(vector: Array, sigma: Array) -> tuple[float, float]:
    """Return the length of a vector and the standard deviation along it."""
    size = float(np.linalg.norm(vector))
    if size == 0:
        return 0.0, float(np.max(sigma))
    return size, float(np.linalg.norm(vector / size * sigma))


def _apart(pairs: Sequence[PairResult]) -> str:
    """Describe the pair of heads that differs most."""
    if not pairs:
        return "The heads differ"
    worst = max(pairs, key=lambda pair: pair.difference.agreement.chi2)
    difference = worst.difference
    return (
        f"{worst.reference} and {worst.unit} differ by {difference.angle_rad / ARCSEC_RAD:.1f}″ ± "
        f"{difference.angle_sigma_rad / ARCSEC_RAD:.1f}″"
    )
