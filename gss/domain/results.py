"""Results of a pipeline run or of the device."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gss.domain.angles import Array
from gss.domain.camera import Camera
from gss.domain.errors import BadInput
from gss.domain.frames import ra_dec_roll_rad
from gss.domain.rotation import matrix_from_quaternion

BLIND = "blind"
"""Camera name of a solution computed without assuming a camera."""


class Outcome(StrEnum):
    """Outcome of a chain: SOLVED if it computed an attitude, otherwise NONE."""

    SOLVED = "solved"
    NONE = "none"


class Verdict(StrEnum):
    """Comparison of a result with the truth. The number of WRONG results must be zero."""

    CORRECT = "correct"
    IMPRECISE = "imprecise"
    WRONG = "wrong"
    NONE = "none"


class Region(NamedTuple):
    """Connected set of pixels above threshold. Bounds are inclusive. ``rejected``: reason why the region is not a star, ""
    if it is accepted."""

    col_min: int
    row_min: int
    col_max: int
    row_max: int
    area_px: int
    peak_dn: float
    sum_dn: float
    rejected: str = ""


@dataclass(frozen=True)
class Centroids:
    """n measured stars, brightest first. Positions are in pixels (pixel centres at integers). Flux is above the background."""

    col_px: Array
    row_px: Array
    flux_dn: Array
    peak_dn: Array
    area_px: NDArray[np.int32]
    sigma_px: Array

    def __post_init__(self) -> None:
        if len(self.row_px) != len(self.col_px):
            raise BadInput(
                "the centroids have different numbers of columns and rows",
                expected=f"{len(self.col_px)} rows",
                got=str(len(self.row_px)),
            )

    def __len__(self) -> int:
        return len(self.col_px)

    @property
    def pixels(self) -> Array:
        """(n, 2) array of (col, row)."""
        pixels = np.empty((len(self), 2))
        pixels[:, 0], pixels[:, 1] = self.col_px, self.row_px
        return pixels

    def take(self, index: NDArray[np.bool_] | NDArray[np.intp]) -> Centroids:
        """Return the rows selected by a mask or an index array."""
        return Centroids(
            self.col_px[index],
            self.row_px[index],
            self.flux_dn[index],
            self.peak_dn[index],
            self.area_px[index],
            self.sigma_px[index],
        )

    def mirrored(self, columns: int) -> Centroids:
        """Return the centroids of the left-right mirrored frame of ``columns`` pixels width."""
        return replace(self, col_px=columns - 1 - self.col_px)

    @classmethod
    def from_pixels(cls, pixels: Array, flux_dn: Array | None = None, sigma_px: float = 0.2) -> Centroids:
        """Return centroids without pixel data, for example from a device's telemetry."""
        p = np.asarray(pixels, float).reshape(-1, 2)
        n = len(p)
        flux = np.ones(n) if flux_dn is None else np.asarray(flux_dn, float)
        return cls(p[:, 0], p[:, 1], flux, flux.copy(), np.zeros(n, np.int32), np.full(n, sigma_px))


@dataclass(frozen=True)
class Matches:
    """m identified stars.

    ``centroid``: row in Centroids. ``residual_px``: (m, 2) measured − predicted, NaN without an attitude. ``weight``:
    weight in the attitude fit; 0 for a star that is identified but excluded from the fit.
    """

    centroid: NDArray[np.int32]
    hip: NDArray[np.int32]
    weight: Array
    residual_px: Array

    def __len__(self) -> int:
        return len(self.hip)


@dataclass(frozen=True)
class Attitude:
    """Camera attitude. ``quaternion``: scalar-last, cam_from_icrs. ``covariance_rad2``: (3, 3) covariance of the small
    rotation vector in the camera frame (x, y cross-boresight, z about boresight), NaN if the chain does not compute it."""

    quaternion: Array
    covariance_rad2: Array

    @property
    def cam_from_icrs(self) -> Array:
        """(3, 3) rotation matrix."""
        return matrix_from_quaternion(self.quaternion)

    @property
    def ra_dec_roll_rad(self) -> tuple[float, float, float]:
        """Boresight right ascension, declination, and roll."""
        return ra_dec_roll_rad(self.cam_from_icrs)

    @property
    def sigma_rad(self) -> tuple[float, float]:
        """Standard deviations across and about the boresight. The first value is per axis: the rms of x and y."""
        c = self.covariance_rad2
        return float(np.sqrt((c[0, 0] + c[1, 1]) / 2)), float(np.sqrt(c[2, 2]))


@dataclass(frozen=True)
class Turning:
    """Angular velocity of the camera relative to ICRS during one exposure, measured from star trails.

    ``vector_rad_s``: (3,) in camera axes. ``covariance_rad2_s2``: (3, 3). A trail does not show its direction of motion:
    unless ``sign_known`` is True, the opposite vector fits equally well. ``stars``: number of measured trails.
    """

    vector_rad_s: Array
    covariance_rad2_s2: Array
    stars: int
    sign_known: bool = False

    @property
    def speed_rad_s(self) -> float:
        """Magnitude of the angular velocity."""
        return float(np.linalg.norm(self.vector_rad_s))

    @property
    def sigma_rad_s(self) -> tuple[float, float, float]:
        """Standard deviation per axis."""
        x, y, z = np.sqrt(np.diag(self.covariance_rad2_s2))
        return float(x), float(y), float(z)


@dataclass(frozen=True)
class SolveResult:
    """Result of one chain on one frame, with its intermediate data for inspection.

    ``camera``: geometry at the end of the run (refined for images of unknown cameras). ``reason``: reason for a missing
    solution. ``false_match_probability``: upper bound on the probability that the identification is accidental; NaN if the
    chain does not compute it. ``timing_s``: duration of each stage; empty without a clock. ``notes``: sentences for the
    user. ``velocity_c``: ICRS velocity of the observer in units of c; None if aberration was not corrected. ``turning``:
    angular rate from trails, None if not measured. ``versions``: software versions by name. ``options``: changed constants
    of the chain, ``NAME=VALUE, …``; empty if none was changed.
    """

    chain: str
    outcome: Outcome
    reason: str
    camera: Camera
    regions: tuple[Region, ...]
    centroids: Centroids
    matches: Matches | None
    attitude: Attitude | None
    false_match_probability: float
    timing_s: dict[str, float] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    velocity_c: tuple[float, float, float] | None = None
    turning: Turning | None = None
    versions: dict[str, str] = field(default_factory=dict)
    options: str = ""

    @property
    def residual_rms_px(self) -> float:
        """Weighted root mean square residual per axis of the used matches; NaN without a solution.

        Without weights, hundreds of faint stars would dominate the few dozen stars that determine the attitude.
        """
        if self.matches is None or not (self.matches.weight > 0).any():
            return float("nan")
        used = self.matches.weight > 0
        square_px2 = np.mean(self.matches.residual_px[used] ** 2, axis=1)
        return float(np.sqrt(np.average(square_px2, weights=self.matches.weight[used])))


@dataclass(frozen=True)
class Truth:
    """Ground truth of a rendered image: the attitude, and the stars on the detector with their noise-free positions."""

    quaternion: Array
    hip: NDArray[np.int32]
    pixels: Array
    v_mag: Array
