"""Angular velocity from attitudes: the stellar gyro proposed in Erlank 2013 §7.2."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gss.domain.angles import Array
from gss.domain.errors import BadInput
from gss.domain.results import Attitude
from gss.domain.rotation import vector_from_rotation

HALF_TURN_RAD = 3.0


@dataclass(frozen=True)
class Rate:
    """Mean angular velocity of the camera relative to ICRS between two images. ``vector_rad_s``: (3,) in the camera
    axes of the second image; ``covariance_rad2_s2``: its (3, 3) covariance from those of the two attitudes, NaN if the
    chain does not provide them."""

    vector_rad_s: Array
    covariance_rad2_s2: Array
    interval_s: float

    @property
    def speed_rad_s(self) -> float:
        """Return the magnitude of the angular velocity."""
        return float(np.linalg.norm(self.vector_rad_s))

    @property
    def sigma_rad_s(self) -> tuple[float, float, float]:
        """Return the standard deviation per axis."""
        x, y, z = np.sqrt(np.diag(self.covariance_rad2_s2))
        return float(x), float(y), float(z)


def rate_between(first: Attitude, second: Attitude, interval_s: float) -> Rate:
    """Return the constant angular velocity that leads from one attitude to the other in ``interval_s``.

    If the camera rotates by the vector φ (right-handed, camera axes), the sky rotates by −φ in its frame:
    second_from_first = exp(−[φ]×). A rotation of more than about 170° between two images cannot be distinguished from the
    opposite rotation and raises :class:`BadInput`, as does an interval that is not positive.
    """
    second_from_first = second.cam_from_icrs @ first.cam_from_icrs.T
    rotated_covariance = second_from_first @ first.covariance_rad2 @ second_from_first.T
    return rate_of_rotation(second_from_first, rotated_covariance + second.covariance_rad2, interval_s)


def rate_of_rotation(second_from_first: Array, covariance_rad2: Array, interval_s: float) -> Rate:
    """Return the constant angular velocity of a (3, 3) rotation in ``interval_s``. ``covariance_rad2``: (3, 3) of the small
    rotation vector in the second camera frame. See :func:`rate_between`."""
    if not interval_s > 0:
        raise BadInput(
            "no rate can be computed for two images of the same time",
            expected="an interval above 0 s",
            got=f"{interval_s:g} s",
        )
    rotation_rad = -vector_from_rotation(second_from_first)
    if np.linalg.norm(rotation_rad) > HALF_TURN_RAD:
        raise BadInput(
            "the rotation between two images is too large to determine its direction",
            expected=f"less than {np.degrees(HALF_TURN_RAD):.0f}°",
            got=f"{np.degrees(np.linalg.norm(rotation_rad)):.0f}°",
        )
    return Rate(rotation_rad / interval_s, covariance_rad2 / interval_s**2, interval_s)
