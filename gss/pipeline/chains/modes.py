"""Prior knowledge of a sensor's chain: modes, their transitions, and the hint (Erlank 2013 §5.3.4)."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from gss.domain.angles import Array
from gss.domain.errors import BadInput
from gss.domain.rotation import matrix_from_quaternion


class Mode(StrEnum):
    """Amount of prior knowledge. ``state`` is the flag in the device's flash memory (Erlank 2013 §5.3.4)."""

    LOST_IN_SPACE = "lost_in_space"
    ASSISTED = "assisted"
    TRACKING = "tracking"

    @property
    def state(self) -> int:
        """Return the flag: 2 lost in space, 1 assisted, 0 tracking."""
        return {Mode.LOST_IN_SPACE: 2, Mode.ASSISTED: 1, Mode.TRACKING: 0}[self]


def next_mode(mode: Mode, solved: bool) -> Mode:
    """Return the mode of the next iteration: tracking after an attitude, and the next weaker mode after a failure.

    The document states only that the result of the attitude determination sets the flag (§5.3.4) and asks for better
    rules (§7.2). After a failed tracking frame the previous boresight is still useful, so assisted mode follows before
    lost in space.
    """
    if solved:
        return Mode.TRACKING
    return Mode.ASSISTED if mode is Mode.TRACKING else Mode.LOST_IN_SPACE


@dataclass(frozen=True)
class AttitudePrior:
    """Prior attitude: (3,) boresight in ICRS, and the (4,) quaternion cam_from_icrs if the full attitude is known.
    ``earlier``: quaternions of the iterations before this attitude, newest first, for predictors. ``ages_s``: times
    from the last attitude, and from each earlier attitude, to the frame. If a time is missing, all attitudes are
    assumed to be one second apart."""

    boresight_icrs: Array
    quaternion: Array | None = None
    earlier: tuple[Array, ...] = ()
    ages_s: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        if len(self.ages_s) <= len(self.earlier):
            object.__setattr__(self, "ages_s", tuple(float(k) for k in range(1, len(self.earlier) + 2)))

    @classmethod
    def from_quaternion(
        cls, quaternion: Array, earlier: tuple[Array, ...] = (), ages_s: tuple[float, ...] = ()
    ) -> AttitudePrior:
        """Return a prior with the full attitude."""
        q = np.asarray(quaternion, float)
        return cls(matrix_from_quaternion(q)[2], q, earlier, ages_s)

    @property
    def steps(self) -> float:
        """Return the time from the last attitude to the frame, divided by the time between the last two attitudes; 1
        without earlier attitudes."""
        return self.ages_s[0] / (self.ages_s[1] - self.ages_s[0]) if self.earlier else 1.0


def check_hint(mode: Mode, hint: AttitudePrior | None) -> None:
    """Raise BadInput if the prior knowledge that a mode needs is missing."""
    if mode is Mode.LOST_IN_SPACE:
        return
    if hint is None or (mode is Mode.TRACKING and hint.quaternion is None):
        need = "a full attitude" if mode is Mode.TRACKING else "a boresight or an attitude"
        raise BadInput(f"{mode.value} needs a hint", expected=need, got="none" if hint is None else "a boresight only")
