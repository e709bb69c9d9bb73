"""Matched stars of one frame, the input of every calibration from the sky."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gss.domain.angles import Array
from gss.domain.errors import BadInput
from gss.domain.results import Centroids, SolveResult
from gss.domain.stars import Ids, StarTable
from gss.pipeline.psf import brightest_dn

CLIPPED_SHARE = 0.98
PER_STAR = ("sigma_px", "hip", "v_mag", "b_v", "flux_dn", "peak_dn", "area_px")


@dataclass(frozen=True)
class FrameStars:
    """Measured and identified stars of one frame; n is their number.

    ``pixels``: (n, 2) col, row. ``sigma_px``: (n,) standard deviation per axis. ``icrs``: (n, 3) apparent unit vectors
    (epoch of the night; with aberration if it matters for a wide field and small errors). ``flux_dn``: above the
    background. ``streak_px``: length of the trails. ``peak_dn``: brightest pixel; ``saturation_dn``: level of a saturated
    peak; ``sky_dn``: level of the sky, 0 if the peaks are above the sky.
    """

    name: str
    columns: int
    rows: int
    pixels: Array
    sigma_px: Array
    icrs: Array
    hip: Ids
    v_mag: Array
    b_v: Array
    flux_dn: Array
    peak_dn: Array
    area_px: NDArray[np.int32]
    exposure_s: float = float("nan")
    time_s: float = float("nan")
    streak_px: float = 0.0
    saturation_dn: float = float("inf")
    sky_dn: float = 0.0

    def __post_init__(self) -> None:
        n = len(self.pixels)
        shapes = {"pixels": (n, 2), "icrs": (n, 3)} | dict.fromkeys(PER_STAR, (n,))
        for name, shape in shapes.items():
            got = getattr(self, name).shape
            if got != shape:
                raise BadInput(f"frame {self.name}: {name} has the wrong shape", expected=str(shape), got=str(got))
        if n and not (np.isfinite(self.pixels).all() and np.isfinite(self.icrs).all() and (self.sigma_px > 0).all()):
            raise BadInput(
                f"frame {self.name}: invalid positions or errors",
                expected="finite positions, errors above 0 px",
                got="NaN or 0",
            )

    def __len__(self) -> int:
        return len(self.pixels)

    @property
    def saturated(self) -> NDArray[np.bool_]:
        """Return an (n,) mask, True for stars with a saturated peak."""
        return np.asarray(self.peak_dn >= CLIPPED_SHARE * self.saturation_dn)

    def take(self, index: NDArray[np.bool_] | NDArray[np.intp]) -> FrameStars:
        """Return the stars selected by a mask or an index array."""
        columns = {"pixels", "icrs", *PER_STAR}
        values = {f.name: getattr(self, f.name) for f in fields(self)}
        return FrameStars(**{n: v[index] if n in columns else v for n, v in values.items()})


def frame_stars(
    name: str,
    result: SolveResult,
    stars: StarTable,
    *,
    exposure_s: float = float("nan"),
    time_s: float = float("nan"),
    streak_px: float = 0.0,
    saturation_dn: float = float("inf"),
    pixels: NDArray[Any] | None = None,
) -> FrameStars | None:
    """Return the matches of a solved frame that were used for its attitude. None without a solution. Stars that are not
    in ``stars`` are omitted. ``pixels``: (rows, columns) frame, from which peaks and sky are read. Without it, the peaks
    are those of the chain, which can be above the sky and without saturated pixels."""
    if result.matches is None or result.attitude is None:
        return None
    row_of = stars.row_of_hip
    used = [k for k, h in enumerate(result.matches.hip.tolist()) if result.matches.weight[k] > 0 and int(h) in row_of]
    rows = np.array([row_of[int(result.matches.hip[k])] for k in used], np.intp)
    centroids = result.centroids.take(result.matches.centroid[used].astype(np.intp))
    size = (result.camera.columns, result.camera.rows)
    frame = of_centroids(name, size, centroids, stars, rows, exposure_s, time_s, streak_px, saturation_dn)
    if pixels is None:
        return frame
    return replace(frame, peak_dn=brightest_dn(pixels, centroids.pixels), sky_dn=float(np.median(pixels)))


def of_centroids(
    name: str,
    size: tuple[int, int],
    centroids: Centroids,
    stars: StarTable,
    rows: NDArray[np.intp],
    exposure_s: float = float("nan"),
    time_s: float = float("nan"),
    streak_px: float = 0.0,
    saturation_dn: float = float("inf"),
) -> FrameStars:
    """Build the stars of a frame from centroids and the row of each in ``stars``. ``size``: columns, rows of the detector."""
    return FrameStars(
        name,
        *size,
        centroids.pixels,
        np.asarray(centroids.sigma_px, float),
        stars.icrs[rows],
        stars.hip[rows],
        stars.v_mag[rows],
        stars.b_v[rows],
        centroids.flux_dn,
        centroids.peak_dn,
        centroids.area_px,
        exposure_s,
        time_s,
        streak_px,
        saturation_dn,
    )
