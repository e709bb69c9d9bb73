"""Error that is fixed to the pixels. It is caused by differences of response and dark current, and by any other error
that recurs when a star returns to a pixel.

Residuals of one star in two frames have independent noise. If the star is on the same part of a pixel in both frames,
the covariance of its residuals contains the pixel error and the error of its catalogue position. If the star is some
pixels away in the second frame, the covariance contains only the catalogue error. The difference between the two
covariances is the error of the pixels.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gss.domain.angles import Array
from gss.domain.errors import BadInput
from gss.pipeline.sheet.rows import draws, interval
from gss.pipeline.sheet.spatial import SpatialErrors, StarSightings

SAME_PX = 0.15
OTHER_PX = 1.5
MIN_PAIRS = 200
MIN_STARS = 15
MAX_PER_STAR = 40


@dataclass(frozen=True)
class PatternError:
    """Attitude error ``value_rad`` (3,) per camera axis with its 95 % interval, and the error per star and axis in
    pixels that causes it, weighted like the stars in the attitude. ``catalogue_px``: error of a star that does not
    depend on its position on the detector. ``pairs``, ``stars``: numbers of pairs and stars used."""

    value_rad: Array
    low_rad: Array
    high_rad: Array
    value_px: float
    low_px: float
    high_px: float
    catalogue_px: float
    pairs: int
    stars: int


def pattern_error(sightings: StarSightings, spatial: SpatialErrors, rng: np.random.Generator) -> PatternError:
    """Compute the error. Raises BadInput without stars that return to a pixel and also move to other pixels."""
    near: list[Array] = []
    far: list[Array] = []
    pairs = distant_pairs = stars = 0
    ok = np.isfinite(spatial.rest_px).all(axis=1)
    # The attitude fit uses three of the 2k degrees of freedom of a frame with k stars.
    coordinates = 2 * np.count_nonzero(ok) / max(1, len(np.unique(sightings.frame[ok])))
    shrunk = max(0.1, 1 - 3 / coordinates)
    for hip in np.unique(sightings.hip[ok]).tolist():
        rows = np.flatnonzero(ok & (sightings.hip == hip))
        rows = rows[rng.permutation(len(rows))[:MAX_PER_STAR]]
        first, second = np.triu_indices(len(rows), 1)
        apart = sightings.frame[rows[first]] != sightings.frame[rows[second]]
        shift = sightings.pixels[rows[first]] - sightings.pixels[rows[second]]
        move = np.linalg.norm(shift, axis=1)
        close, distant = apart & (move < SAME_PX), apart & (move > OTHER_PX)
        # Share of the pixel's area that the star covers in both frames.
        share = np.where(close, np.prod(1 - np.minimum(np.abs(shift), 0.5), axis=1), 1.0)
        product = spatial.rest_px[rows[first]] * spatial.rest_px[rows[second]] / (shrunk * share[:, None])
        weight = np.sqrt(spatial.gain2[rows[first]] * spatial.gain2[rows[second]])
        near.append(_sums(product[close], weight[close]))
        far.append(_sums(product[distant], weight[distant]))
        pairs, distant_pairs = pairs + int(close.sum()), distant_pairs + int(distant.sum())
        stars += bool(close.any())
    if pairs < MIN_PAIRS or stars < MIN_STARS or distant_pairs < MIN_PAIRS:
        raise BadInput(
            "too few stars return to the same pixels",
            expected=f"{MIN_PAIRS} pairs within {SAME_PX} px and as many beyond {OTHER_PX} px, of {MIN_STARS} stars",
            got=f"{pairs} and {distant_pairs} pairs, {stars} stars",
        )
    return _estimated(np.array(near), np.array(far), spatial, pairs, stars, rng)


def _sums(product: Array, weight: Array) -> Array:
    """Return the (2, 3) weighted sum of (k, 2) products per axis of the attitude, and the sum of the (k, 2, 3) weights."""
    return np.stack([(product[:, :, None] * weight).sum(axis=(0, 1)), weight.sum(axis=(0, 1))])


def _estimated(
    near: Array, far: Array, spatial: SpatialErrors, pairs: int, stars: int, rng: np.random.Generator
) -> PatternError:
    """Return the error from the sums of the stars (s, 2, 3). The interval is from bootstrap samples of the stars."""
    gain2 = (spatial.gain_rad_px**2).mean(axis=0)
    stars_near, stars_far = near.reshape(len(near), -1), far.reshape(len(far), -1)

    def squares(times: Array) -> Array:
        a, b = ((times @ flat).reshape(*times.shape[:-1], 2, 3) for flat in (stars_near, stars_far))
        with np.errstate(invalid="ignore", divide="ignore"):
            amplitude = b[..., 0, :] / b[..., 1, :]
            return np.stack([a[..., 0, :] / a[..., 1, :] - amplitude, amplitude], axis=-2)

    value = squares(np.ones(len(near)))
    low, high = interval(squares(draws(np.arange(len(near), dtype=np.intp), rng)))
    angles = [np.sqrt(np.maximum(v[0], 0) * gain2) for v in (value, low, high)]
    # For the rotation about the boresight, the weights of the stars differ. Therefore the error per star is computed
    # from the two axes across the boresight.
    star = [float(np.sqrt(max(v[0, :2].mean(), 0.0))) for v in (value, low, high)]
    amplitude = float(np.sqrt(max(value[1, :2].mean(), 0.0)))
    return PatternError(angles[0], angles[1], angles[2], star[0], star[1], star[2], amplitude, pairs, stars)
