"""Comparison of the heads of one spacecraft: fused attitude, differences and misalignments, updated with each new attitude.

Heads measure at different times. They are compared at the times at which the first usable head measured. After each
other head has reported a later attitude, its attitude is calculated for these times.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from gss.domain.angles import Array
from gss.operations.heads.mountings import HeadMounting, SpacecraftSetup
from gss.operations.telemetry.last_attitude import AttitudeSample
from gss.pipeline.heads.fusion import FusedAttitude, HeadDifference, difference, fuse, in_body
from gss.pipeline.heads.misalignment import Misalignment, started, updated
from gss.pipeline.heads.pairing import MAX_STEP_S, AttitudeAt, MeasuredAttitude, attitude_at
from gss.pipeline.track.cameras_together import BodyAttitude

KEPT = 40
MAX_WAITING = 200
PRIOR_RAD = float(np.radians(1.0))
"""A-priori standard deviation of a misalignment before the first comparison. Larger misalignments are also estimated."""
STEADY_SHARE = 0.6
"""Fraction of an attitude's sigma that stays constant while the same stars are on the same pixels. Measured with simulated
CubeStar units: at rest, the mean errors of 18 heads with different stars were 0.57 sigma (root mean square of all axes). With 16
heads and a body rate of 0.02°/s, errors 20 s to 100 s apart had a correlation of 0.1 to 0.05 sigma², which vanished after
300 s."""
CLOCK_BACK_S = 60.0
"""If a new attitude is older than the latest attitude or estimate by more than this time, a clock was set back. The
misalignment estimates then continue from the new time."""


@dataclass(frozen=True)
class PairResult:
    """One head compared with the reference head. ``lasting_rad2`` (3, 3): contribution of clock errors and steady errors to the
    covariance of the misalignment."""

    reference: str
    unit: str
    difference: HeadDifference
    misalignment: Misalignment
    lasting_rad2: Array

    @property
    def sigma_rad(self) -> Array:
        """(3,) standard deviation of the misalignment, including clock errors and steady errors."""
        return np.sqrt(self.misalignment.sigma_rad**2 + np.diag(self.lasting_rad2))

    @property
    def drift_sigma_rad_s(self) -> Array:
        """(3,) standard deviation of the drift; see :func:`drift_sigma`."""
        return drift_sigma(self.misalignment, np.diag(self.lasting_rad2))


def drift_sigma(estimate: Misalignment, lasting_rad2: Array) -> Array:
    """Return the (3,) standard deviation of the drift, rad/s. It includes errors that do not average out, because these
    can have changed by their standard deviation since the estimate began. ``lasting_rad2``: (3,) variances of these
    errors."""
    since_s = max(estimate.time_s - estimate.began_s, 1.0)
    return np.asarray(np.sqrt(estimate.drift_sigma_rad_s**2 + lasting_rad2 / since_s**2))


@dataclass(frozen=True)
class HeadsResult:
    """Comparison of all heads at one time. ``attitudes``: unit to the body attitude from that head, including mounting and clock
    uncertainty. ``missing``: unit to the reason why that head could not be used."""

    time_s: float
    attitudes: Mapping[str, BodyAttitude]
    missing: Mapping[str, str]
    fused: FusedAttitude
    pairs: tuple[PairResult, ...]


@dataclass
class _Series:
    """Received attitudes of one head, oldest first. ``problem``: reason why its latest attitude cannot be used, ""
    otherwise."""

    attitudes: deque[MeasuredAttitude] = field(default_factory=lambda: deque(maxlen=KEPT))
    newest_s: float | None = None
    problem: str = ""


class HeadTracker:
    """Compares the heads of one spacecraft. ``resumed``: unit to its stored misalignment estimate. Not thread-safe."""

    def __init__(self, setup: SpacecraftSetup, resumed: Mapping[str, Misalignment]) -> None:
        self.setup = setup
        self.result: HeadsResult | None = None
        """The latest comparison, None before the first."""
        self._missing: Mapping[str, str] = {}
        self._series = {head.unit: _Series() for head in setup.heads}
        self._filters = dict(resumed)
        self._waiting: deque[float] = deque(maxlen=MAX_WAITING)

    def add(self, unit: str, sample: AttitudeSample, now_s: float) -> None:
        """Add an attitude of a unit. An attitude from another source, or one that was added before, is ignored."""
        head = self.setup.head(unit)
        if head is None or sample.source != self.setup.source:
            return
        series, time_s = self._series[unit], sample.utc.timestamp()
        if series.newest_s is not None and time_s < series.newest_s - CLOCK_BACK_S:
            self._series[unit] = series = _Series()
            self._waiting.clear()
        if series.newest_s is not None and time_s <= series.newest_s:
            return
        covariance = head.covariance(sample.sigma_cross_arcsec, sample.sigma_roll_arcsec)
        series.newest_s = time_s
        if covariance is None:
            series.problem = "the sensor reports no valid standard deviations, and none are stated for this head"
            return
        series.problem = ""
        attitude = in_body(np.array(sample.quaternion), covariance, head.body_from_cam)
        series.attitudes.append(MeasuredAttitude(time_s, sample.utc_sigma_s, attitude))
        usable = (h.unit for h in self.setup.heads if self.is_fresh(h.unit, now_s) and not self.problem(h.unit))
        if unit == next(usable, unit):
            self._waiting.append(time_s)

    def age_s(self, unit: str, now_s: float) -> float | None:
        """Return the age of a head's latest attitude, None before the first."""
        newest_s = self._series[unit].newest_s
        return None if newest_s is None else max(0.0, now_s - newest_s)

    def is_fresh(self, unit: str, now_s: float) -> bool:
        """True if the head's latest attitude is not stale."""
        age_s = self.age_s(unit, now_s)
        return age_s is not None and age_s <= self.setup.stale_s

    def problem(self, unit: str) -> str:
        """Return the reason why the head's latest attitude cannot be used, "" if it can be used."""
        return self._series[unit].problem

    def lacks(self, unit: str) -> str:
        """Return the reason why a head was missing in the latest comparison, "" if no reason is known."""
        return self.problem(unit) or self._missing.get(unit, "")

    def advance(self, now_s: float) -> list[HeadsResult]:
        """Compare the heads at each waiting time for which all fresh heads have reported or ``stale_s`` has passed. Return the
        results."""
        results = []
        while self._waiting and self._is_complete(self._waiting[0], now_s):
            result = self._compare(self._waiting.popleft(), now_s)
            if result is not None:
                self.result = result
                results.append(result)
        return results

    def _is_complete(self, time_s: float, now_s: float) -> bool:
        newest = (self._series[h.unit].newest_s for h in self.setup.heads if self.is_fresh(h.unit, now_s))
        return now_s - time_s > self.setup.stale_s or all(at_s is not None and at_s >= time_s for at_s in newest)

    def _compare(self, time_s: float, now_s: float) -> HeadsResult | None:
        usable: dict[str, AttitudeAt] = {}
        missing: dict[str, str] = {}
        for head in self.setup.heads:
            sample, reason = self._at(head, time_s, now_s)
            if sample is None:
                missing[head.unit] = reason
            else:
                usable[head.unit] = sample
        self._missing = missing
        if not usable:
            return None
        attitudes = {unit: self._with_mounting(unit, at) for unit, at in usable.items()}
        fused = fuse(list(attitudes.values()))
        return HeadsResult(time_s, attitudes, missing, fused, self._pairs(time_s, usable, attitudes))

    def _at(self, head: HeadMounting, time_s: float, now_s: float) -> tuple[AttitudeAt | None, str]:
        """Return the head's attitude at a time. If there is none, return None and the reason."""
        series = self._series[head.unit]
        if series.problem:
            return None, series.problem
        if not self.is_fresh(head.unit, now_s):
            return None, "no attitude received" if series.newest_s is None else "silent"
        setup = self.setup
        sample = attitude_at(list(series.attitudes), time_s, setup.tolerance_s, setup.largest_rate_rad_s)
        offset_s = min((abs(attitude.time_s - time_s) for attitude in series.attitudes), default=math.inf)
        if offset_s > setup.tolerance_s:
            return (
                sample,
                f"its nearest attitude is {offset_s:.1f} s from the other's, the tolerance is {setup.tolerance_s:g} s",
            )
        return sample, (
            f"its rate is unknown, because it has no two attitudes within {MAX_STEP_S:g} s and no largest rate of the body "
            "is stated"
        )

    def _with_mounting(self, unit: str, at: AttitudeAt) -> BodyAttitude:
        head = self.setup.head(unit)
        mounting = np.zeros((3, 3)) if head is None else head.mounting_rad2
        return BodyAttitude(at.attitude.quaternion, at.with_timing.covariance_rad2 + mounting)

    def _pairs(
        self, time_s: float, usable: Mapping[str, AttitudeAt], attitudes: Mapping[str, BodyAttitude]
    ) -> tuple[PairResult, ...]:
        """Compare all heads with the reference head, which is the first head of the spacecraft."""
        reference = self.setup.heads[0]
        first = usable.get(reference.unit)
        if first is None:
            return ()
        pairs = []
        for head in self.setup.heads[1:]:
            second = usable.get(head.unit)
            if second is None:
                continue
            random = first.attitude.covariance_rad2 + second.attitude.covariance_rad2
            lasting = first.timing_rad2 + second.timing_rad2 + STEADY_SHARE**2 * random
            before = self._filters.get(head.unit) or started(time_s, np.eye(3) * PRIOR_RAD**2)
            back_s = before.time_s - time_s
            if back_s > CLOCK_BACK_S:
                before = replace(before, time_s=time_s, began_s=before.began_s - back_s)
            elif back_s > 0:
                continue
            after = updated(before, time_s, first.attitude, second.attitude, lasting)
            self._filters[head.unit] = after
            measured = difference(attitudes[reference.unit], attitudes[head.unit], reference.boresight, head.boresight)
            pairs.append(PairResult(reference.unit, head.unit, measured, after, lasting))
        return tuple(pairs)
