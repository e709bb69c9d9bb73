"""Principal point from the circle of light behind a second, identical lens that faces the lens of the camera (Erlank
2013 §5.4, Figs. 5.9, 5.10)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gss.domain.angles import Array
from gss.domain.errors import BadInput
from gss.pipeline.calibration.advice import Advice

MIN_RADIUS_PX = 12.0
MIN_SLOPE = 0.05
MIN_CONTRAST = 10.0  # light of the centre, in σ of a pixel
ROUNDS, CLOSE_PX = 60, 1e-4
PARTS = (0.5, 0.75, 1.0)  # radii of the discs that are compared, as shares of the largest
DARK_SHARE = 0.02  # light at the rim of the largest disc, as a share of the light of the centre
HINT = "fasten a second, identical lens to the front of the camera's lens, facing it, and light its open end evenly"


@dataclass(frozen=True)
class LightCircle:
    """Centre of a circle of light in one picture. ``noise_px``: σ per axis from the scatter of the pixels.
    ``asymmetry_px``: largest distance between the centres of discs with half, three quarters and all of ``radius_px``,
    the radius of the largest disc. ``half_px``: radius at which the light is half of that in the centre."""

    col_px: float
    row_px: float
    noise_px: float
    asymmetry_px: float
    radius_px: float
    half_px: float

    @property
    def sigma_px(self) -> float:
        """σ per axis from noise and asymmetry."""
        return float(np.hypot(self.noise_px, self.asymmetry_px))


@dataclass(frozen=True)
class PrincipalPoint:
    """Principal point from one or more pictures. ``sigma_px``: σ per axis. ``scatter_px``: standard deviation per axis
    of the centres of several pictures, None for one picture."""

    col_px: float
    row_px: float
    sigma_px: float
    scatter_px: float | None
    circles: tuple[LightCircle, ...]
    warnings: tuple[Advice, ...]


def principal_point(pictures: Sequence[Array]) -> PrincipalPoint:
    """Return the mean centre of the circles of light in (rows, columns) pictures of one camera.

    The document takes one picture. If the second lens is turned about its axis, with its lamp, by equal steps between
    several pictures, the mean contains neither its decentring nor a slope of the light, and σ includes them as scatter.
    A displacement that is the same in all pictures is not part of σ. Raises BadInput for a picture without a circle of
    light.
    """
    if not pictures or len({np.shape(p) for p in pictures}) > 1:
        got = ", ".join(sorted({" x ".join(str(n) for n in np.shape(p)[::-1]) for p in pictures})) or "none"
        raise BadInput("unsuitable pictures", expected="one or more pictures of the same size", got=got)
    circles = tuple(circle_of_light(p) for p in pictures)
    centres = np.array([(c.col_px, c.row_px) for c in circles])
    col, row = (float(v) for v in centres.mean(axis=0))
    count = len(circles)
    own = float(np.sqrt(sum(c.noise_px**2 for c in circles))) / count
    # Noise differs between pictures. The cause of an asymmetry, such as the lamp, can be the same in all of them.
    own = float(np.hypot(own, max(c.asymmetry_px for c in circles)))
    scatter = float(np.sqrt(((centres - centres.mean(axis=0)) ** 2).sum() / (2 * (count - 1)))) if count > 1 else None
    sigma = own if scatter is None else max(own, scatter / float(np.sqrt(count)))
    advice: list[Advice] = []
    if scatter is None:
        hint = "take three or more pictures and turn second lens and lamp by equal steps between them"
        advice.append(
            Advice(
                "one-lens-position",
                "σ includes neither the decentring of the second lens nor a slope of the light",
                hint,
            )
        )
    if max(c.asymmetry_px for c in circles) > max(0.5, 5 * max(c.noise_px for c in circles)):
        text = f"the centre depends on the radius by {max(c.asymmetry_px for c in circles):.2f} px"
        advice.append(
            Advice("uneven-light", text, "light the open end of the second lens evenly, and align the lenses")
        )
    return PrincipalPoint(col, row, sigma, scatter, circles, tuple(advice))


def circle_of_light(picture: Array) -> LightCircle:
    """Return the centre of the circle of light in a (rows, columns) picture.

    The document uses the centroid of the circle. A circle that the edge of the detector cuts has its centroid elsewhere,
    so the centroid is that of the largest complete disc around the centre, and the disc follows its centroid. Raises
    BadInput.
    """
    light = np.asarray(picture, float)
    if light.ndim != 2 or min(light.shape) < 4 * MIN_RADIUS_PX or not np.isfinite(light).all():
        raise BadInput(
            "unsuitable picture", expected="(rows, columns) of finite values", got=f"{light.shape}", hint=HINT
        )
    light = light - _dark_level(light)
    start = _brightest_part(light)
    radius = _largest_disc(light, start)
    centres = [_centred(light, start, radius * part) for part in PARTS]
    centre, slope, mean_e = centres[-1]
    distance, weight = _disc(light.shape, centre, radius)
    profile, residual = _profile(light, distance, radius)
    scatter = float(np.sqrt(np.mean(residual**2)))
    if profile[0] < MIN_CONTRAST * scatter:
        got = f"{profile[0]:.0f} levels in the centre, scatter {scatter:.1f}"
        raise BadInput("no circle of light", expected=f"a centre {MIN_CONTRAST:g} σ above the dark", got=got, hint=HINT)
    noise = scatter * float(np.sqrt(np.sum((weight * distance) ** 2) / 2)) / (mean_e * float(weight.sum()) * slope)
    offsets = [float(np.hypot(*(a[0] - b[0]))) for a in centres for b in centres]
    dim = np.flatnonzero(profile < profile[0] / 2)
    half = float(dim[0]) if len(dim) else radius
    return LightCircle(float(centre[0]), float(centre[1]), noise, max(offsets), radius, half)


def _dark_level(light: Array) -> float:
    """Return the median of the darkest corner."""
    rows, columns = (max(4, n // 20) for n in light.shape)
    corners = (light[a, b] for a in (slice(rows), slice(-rows, None)) for b in (slice(columns), slice(-columns, None)))
    return min(float(np.median(corner)) for corner in corners)


def _brightest_part(light: Array) -> Array:
    """Return the centroid (col, row) of the pixels above half of the brightest light. Single bright pixels have no
    effect on this limit."""
    bright = np.argwhere(light > np.percentile(light, 99) / 2)
    return np.asarray(bright.mean(axis=0)[::-1] if len(bright) else np.array(light.shape[::-1]) / 2)


def _largest_disc(light: Array, centre: Array) -> float:
    """Return the radius of the largest disc around the centre that is on the detector and has light at its rim."""
    rows, columns = light.shape
    radius = float(min(*centre, columns - 1 - centre[0], rows - 1 - centre[1])) - 1
    if radius < MIN_RADIUS_PX:
        got = f"a centre at {centre[0]:.0f}, {centre[1]:.0f}"
        raise BadInput("circle of light at the edge", expected="a centre inside of the detector", got=got, hint=HINT)
    profile, _ = _profile(light, _disc(light.shape, centre, radius)[0], radius)
    dark = np.flatnonzero(profile < DARK_SHARE * profile[0])
    return max(MIN_RADIUS_PX, min(radius, float(dark[0]))) if len(dark) else radius


def _centred(light: Array, start: Array, radius: float) -> tuple[Array, float, float]:
    """Return the centre of a disc that is its own centroid, the slope of the centroid, and the mean light in the disc.

    If the light is displaced by δ in the disc, the centroid moves by δ · (1 − light at the rim / mean light). This
    follows from the divergence theorem.
    """
    rows, columns = light.shape
    centre = np.array(start, float)
    for _ in range(ROUNDS):
        inside = min(*centre, columns - 1 - centre[0], rows - 1 - centre[1])
        if not inside >= MIN_RADIUS_PX:
            break
        reach = min(radius, float(inside))
        distance, weight = _disc(light.shape, centre, reach)
        total = float((weight * light).sum())
        ring = np.abs(distance - reach) < 1.5
        slope = 1 - float(light[ring].mean()) * float(weight.sum()) / total if total > 0 else 0.0
        if slope < MIN_SLOPE:
            break
        row, col = np.ogrid[:rows, :columns]
        moments = [float((weight * light * (axis - c)).sum()) for axis, c in ((col, centre[0]), (row, centre[1]))]
        step = np.array(moments) / total / slope
        centre = centre + step
        if np.hypot(*step) < CLOSE_PX:
            return centre, slope, total / float(weight.sum())
    raise BadInput("no circle of light", expected="light that fades from a centre on the detector", hint=HINT)


def _disc(shape: tuple[int, ...], centre: Array, radius: float) -> tuple[Array, Array]:
    """Return the (rows, columns) distances from the centre, and the share of each pixel inside of the disc."""
    row, col = np.indices(shape, sparse=True)
    distance = np.hypot(col - centre[0], row - centre[1])
    return distance, np.clip(radius - distance + 0.5, 0.0, 1.0)


def _profile(light: Array, distance: Array, radius: float) -> tuple[Array, Array]:
    """Return the mean light at each whole radius in px, and the residuals of the pixels of the disc."""
    inside = distance <= radius
    bins = distance[inside].astype(np.intp)
    counts = np.bincount(bins)
    means = np.bincount(bins, light[inside]) / np.maximum(counts, 1)
    means[: min(4, len(means))] = means[: min(4, len(means))].mean()
    at = np.arange(len(means)) + 0.5
    return means, light[inside] - np.interp(distance[inside], at, means)
