"""Outline of a camera's field of view on the sky, with fast membership tests for millions of directions."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation

from gss.domain.angles import Array
from gss.domain.camera import Camera

PER_SIDE = 256
CHART_CELLS = 512
CHART_INSIDE, CHART_EDGE = 1, 2
# If a cosine differs from its limit by less than this value, the test is repeated with exact angles.
COSINE_TOLERANCE = 1e-9
CORNERS = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0], [0.0, 0.0]])


def widened(camera: Camera, margin_rad: float) -> Camera:
    """Return the camera with its detector enlarged by the margin on each side, at the plate scale of the optical
    centre."""
    pixels = round(margin_rad / camera.pixel_rad)
    return replace(
        camera,
        columns=camera.columns + 2 * pixels,
        rows=camera.rows + 2 * pixels,
        centre_col_px=camera.centre_col_px + pixels,
        centre_row_px=camera.centre_row_px + pixels,
    )


class FieldRegion(Protocol):
    """A region of sky around the boresight, with the two tests that :mod:`gss.catalogue_tools.envelope.reach` uses."""

    def inside(self, unit_cam: Array) -> NDArray[np.bool_]: ...

    def may_be_within(self, unit_cam: Array, slack_rad: Array | float) -> NDArray[np.bool_]: ...


@dataclass(frozen=True)
class CircularField:
    """Circular field: the area that a field covers when it rotates freely about its boresight."""

    radius_rad: float

    @property
    def half_diagonal_rad(self) -> float:
        """Largest angle from the boresight."""
        return self.radius_rad

    def inside(self, unit_cam: Array) -> NDArray[np.bool_]:
        return self.may_be_within(unit_cam, 0.0)

    def inside_planes(self, x: Array, y: Array, z: Array) -> NDArray[np.bool_]:
        """:meth:`inside` for separate component arrays of one shape; optimised for millions of directions."""
        limit = np.cos(min(self.radius_rad, np.pi))
        inside = np.asarray(z >= limit)
        doubtful = np.nonzero(np.abs(z - limit) < COSINE_TOLERANCE)
        inside[doubtful] = self.inside(np.stack([x[doubtful], y[doubtful], z[doubtful]], axis=-1))
        return inside

    def may_be_within(self, unit_cam: Array, slack_rad: Array | float) -> NDArray[np.bool_]:
        x, y, z = np.moveaxis(np.asarray(unit_cam), -1, 0)
        return np.asarray(np.arctan2(np.hypot(x, y), z) <= self.radius_rad + slack_rad)


@dataclass(frozen=True)
class FieldShape:
    """Star-shaped region around the boresight: a tangent-plane radius for every azimuth from camera +x towards +y.

    The outline is interpolated linearly between 4·256 points. The error is below 1e-6 rad for all profiles.
    """

    camera: Camera

    def edge(self, along: Array) -> Array:
        """Return (k, 3) camera-frame unit vectors of the outline at (k,) positions in [0, 4); each side has length
        1."""
        position = np.mod(along, 4.0)
        side = np.minimum(position.astype(int), 3)
        part = (position - side)[:, None]
        corner = CORNERS[side] * (1 - part) + CORNERS[side + 1] * part
        return self.camera.unproject(corner * [self.camera.columns, self.camera.rows] - 0.5)

    @cached_property
    def outline(self) -> Array:
        """(4·PER_SIDE, 3) camera-frame unit vectors."""
        return self.edge(np.arange(4 * PER_SIDE) / PER_SIDE)

    @cached_property
    def half_diagonal_rad(self) -> float:
        """Largest angle from the boresight."""
        u = self.outline
        return float(np.max(np.arctan2(np.hypot(u[:, 0], u[:, 1]), u[:, 2])))

    @cached_property
    def area_sr(self) -> float:
        """Solid angle: ∫(1 − cos ρ) dα over the azimuth."""
        alpha = np.linspace(-np.pi, np.pi, 8192, endpoint=False)
        return float(2 * np.pi * np.mean(1 - 1 / np.sqrt(1 + self._radius(alpha) ** 2)))

    @property
    def equal_circle_rad(self) -> float:
        """Radius of the circle with the same solid angle."""
        return float(np.arccos(1 - self.area_sr / (2 * np.pi)))

    def inside(self, unit_cam: Array) -> NDArray[np.bool_]:
        """Return the (…) mask of the (…, 3) camera-frame unit vectors that are in the field."""
        x, y, z = np.moveaxis(np.asarray(unit_cam), -1, 0)
        return np.asarray((z > 0) & (np.hypot(x, y) <= z * self._radius(np.arctan2(y, x))))

    def inside_planes(self, x: Array, y: Array, z: Array) -> NDArray[np.bool_]:
        """:meth:`inside` for separate component arrays of one shape; optimised for millions of directions.

        A chart of the tangent plane determines the result for all directions except those in cells that the outline
        crosses.
        """
        chart, scale, offset = self._chart
        with np.errstate(divide="ignore", invalid="ignore"):
            inverse = scale / z
            col, row = x * inverse, y * inverse
        # Directions outside the chart, directions behind the camera, and NaN are mapped to the empty border of the
        # chart.
        ahead = (z > 0) & (np.abs(col) < offset) & (np.abs(row) < offset)
        col[~ahead] = row[~ahead] = offset
        state = chart[(row + (offset + 1)).astype(np.int32), (col + (offset + 1)).astype(np.int32)]
        inside = np.asarray(state == CHART_INSIDE)
        doubtful = np.nonzero(state == CHART_EDGE)
        inside[doubtful] = self.inside(np.stack([x[doubtful], y[doubtful], z[doubtful]], axis=-1))
        return inside

    def may_be_within(self, unit_cam: Array, slack_rad: Array | float) -> NDArray[np.bool_]:
        """False only if the field is certainly more than (…,) ``slack_rad`` away from (…, 3) ``unit_cam``.

        A field point at distance d from a point at angle a from the boresight is at least a − d from the boresight and
        at most asin(sin d / sin a) away in azimuth. The test uses the largest field radius in that azimuth window. For
        wide windows, this radius is taken from a table. For narrow windows, it is computed from the radius at the
        azimuth and the steepest slope.
        """
        x, y, z = np.moveaxis(np.asarray(unit_cam), -1, 0)
        flat = np.hypot(x, y)
        angle = np.arctan2(flat, z)
        slack = np.broadcast_to(slack_rad, angle.shape)
        with np.errstate(divide="ignore", invalid="ignore"):
            window = np.where((slack < angle) & (slack < np.pi / 2), np.sin(slack) / flat, 2.0)
        window = np.where(window < 1, np.arcsin(np.minimum(window, 1.0)), np.pi)
        levels, count = len(self._window_max) - 1, len(self._window_max[0])
        steps = window * count / (2 * np.pi) + 1
        level = np.clip(np.ceil(np.log2(steps)).astype(int), 0, levels)
        azimuth = np.arctan2(y, x)
        at = np.round((azimuth + np.pi) * count / (2 * np.pi)).astype(int) % count
        by_slope = np.arctan(self._radius(azimuth)) + self._steepest * window
        return np.asarray(angle - slack <= np.minimum(self._window_max[level, at], by_slope))

    @cached_property
    def _chart(self) -> tuple[NDArray[np.uint8], float, float]:
        """Cells of the tangent plane with an empty border, number of cells per unit, half width in cells.

        Cells crossed by the outline and their neighbours are edge cells. All other cells have the state of their
        centre.
        """
        offset = CHART_CELLS / 2
        u = self.outline
        plane = u[:, :2] / u[:, 2:]
        scale = float(offset / (np.max(np.abs(plane)) * (1 + 4 / CHART_CELLS)))
        middle = (np.arange(CHART_CELLS) + 0.5 - offset) / scale
        col, row = np.meshgrid(middle, middle)
        inside = np.hypot(col, row) <= self._radius(np.arctan2(row, col))
        edge = np.zeros_like(inside)
        fine = self.edge(np.linspace(0, 4, 16 * CHART_CELLS))
        at = np.floor(fine[:, :2] / fine[:, 2:] * scale + offset).astype(int)
        edge[at[:, 1], at[:, 0]] = True
        edge = binary_dilation(edge, np.ones((3, 3), bool))
        chart = np.where(edge, CHART_EDGE, np.where(inside, CHART_INSIDE, 0)).astype(np.uint8)
        return np.pad(chart, 1), scale, offset

    def _radius(self, azimuth_rad: Array) -> Array:
        knots, radius = self._knots
        return np.interp(azimuth_rad, knots, radius)

    @cached_property
    def _knots(self) -> tuple[Array, Array]:
        u = self.outline
        azimuth, radius = np.arctan2(u[:, 1], u[:, 0]), np.hypot(u[:, 0], u[:, 1]) / u[:, 2]
        order = np.argsort(azimuth)
        a, r = azimuth[order], radius[order]
        return np.concatenate([[a[-1] - 2 * np.pi], a, [a[0] + 2 * np.pi]]), np.concatenate([[r[-1]], r, [r[0]]])

    @cached_property
    def _steepest(self) -> float:
        """Largest change of the angular radius per radian of azimuth."""
        knots, radius = self._knots
        return float(np.max(np.abs(np.diff(np.arctan(radius)) / np.maximum(np.diff(knots), 1e-12))))

    @cached_property
    def _window_max(self) -> Array:
        """(levels, 1024) largest angular radius within ±2^level steps of each of 1024 azimuths; the last level is
        the overall maximum."""
        count = 1024
        fine = np.linspace(-np.pi, np.pi, 16 * count, endpoint=False)
        blocks = np.arctan(self._radius(fine)).reshape(count, 16).max(axis=1)
        rows = [np.maximum.reduce([np.roll(blocks, s) for s in (-1, 0, 1)])]
        step = 1
        while step < count // 2:
            rows.append(np.maximum.reduce([rows[-1], np.roll(rows[-1], step), np.roll(rows[-1], -step)]))
            step *= 2
        rows.append(np.full(count, self.half_diagonal_rad))
        return np.stack(rows) + 1e-7
