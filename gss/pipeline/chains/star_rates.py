"""LIST: angular rate from the stars of two frames, without a catalogue (Huffman 2006 Table 1.3, §5.5).

The document describes LIST by its goals and by the matching between frames that it shares with FAR-MST. Therefore the
detection, the matchers and the attitude method are those of the chain far_mst. LIST tracks fewer than four stars:
``max_centroids=3`` with ``acceptance=document``. By default, all stars are used, and a rotation must meet the bound on
accidental matches, which three stars alone cannot meet.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gss.domain.camera import Camera
from gss.domain.errors import BadInput
from gss.domain.results import Centroids
from gss.domain.rotation import matrix_from_quaternion, quaternion_from_matrix, rotation_from_vector
from gss.pipeline.chains.far_mst_parameters import FarMstParameters
from gss.pipeline.chains.far_mst_relative import Relative, relative_attitude
from gss.pipeline.rates import Rate, rate_of_rotation


@dataclass(frozen=True)
class StarRate:
    """Rate between two frames, None with a ``reason``."""

    rate: Rate | None
    relative: Relative
    reason: str


def rate_from_stars(
    before: Centroids,
    after: Centroids,
    camera: Camera,
    parameters: FarMstParameters,
    interval_s: float,
    method: str = "auto",
    previous: Rate | None = None,
) -> StarRate:
    """Return the angular rate from two star lists that are ``interval_s`` apart.

    ``previous``: rate of the previous interval. It gives the expected rotation of the rate match, for a constant rate. There is
    no rate for an interval that is not positive, and for a rotation without a unique direction. Raises BadInput if the method
    needs a rate and there is none.
    """
    expected = None
    if previous is not None:
        expected = quaternion_from_matrix(rotation_from_vector(-previous.vector_rad_s * interval_s))
    relative = relative_attitude(before, after, camera, parameters, method, expected)
    if relative.quaternion is None:
        return StarRate(None, relative, relative.reason)
    turn = np.asarray(matrix_from_quaternion(relative.quaternion))
    try:
        return StarRate(rate_of_rotation(turn, relative.covariance_rad2, interval_s), relative, "")
    except BadInput as error:
        return StarRate(None, relative, str(error))
