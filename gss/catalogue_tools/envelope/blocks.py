"""Jacobs' own way to a sub-catalogue: step through all angles, mark blocks of sky, take the stars in them (Jacobs 1995 §5.2.1).

A replica, kept beside the exact envelope to show what it misses. The document gives neither the steps nor when a block is
"included within the FOV"; both can be chosen.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from gss.catalogue_tools.envelope.attitude import AttitudeLimits, euler_123, orbit_axes
from gss.catalogue_tools.envelope.envelope import BandEnvelope, Moments
from gss.catalogue_tools.envelope.field import FieldShape
from gss.catalogue_tools.envelope.orbits import OrbitRanges, Range
from gss.catalogue_tools.selection.counting import fields_per_star
from gss.domain.angles import Array, unit_from_ra_dec
from gss.domain.errors import BadInput

RULES = ("centre", "whole", "touched")
RA_BLOCKS, DEC_BLOCKS = 360, 180
BLOCK_RAD = float(np.radians(1.0))
# Points of a block that stand for it: its middle, its corners, or a grid over it.
TOUCH_GRID = 5


def _deg(value: float) -> float:
    return float(np.radians(value))


@dataclass(frozen=True)
class BlockSteps:
    """Increments of the six variables of Jacobs 1995 Table 5-2, from minimum to maximum; the document does not give them."""

    roll_rad: float = _deg(5.0)
    pitch_rad: float = _deg(5.0)
    yaw_rad: float = _deg(5.0)
    latitude_rad: float = _deg(10.0)
    inclination_rad: float = _deg(1.0)
    raan_rad: float = _deg(1.0)

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not _deg(0.1) <= value <= 2 * np.pi:
                raise BadInput(
                    f"step of {name[:-4]} is impossible", expected="0.1° to 360°", got=f"{np.degrees(value):g}°"
                )


def stepped(limits: Range, step_rad: float) -> Array:
    """From the minimum by the step up to the maximum, which is met only if the steps fit, as in a FOR loop."""
    low, high = limits
    return np.asarray(low + step_rad * np.arange(int(np.floor((high - low) / step_rad + 1e-9)) + 1), float)


@dataclass(frozen=True)
class BlockEnvelope:
    """An envelope made of marked blocks. ``rule``: a block is marked when its centre, the whole of it or any part of it is in
    the field. Edges, shares of time and attitudes are those of the exact band."""

    shape: FieldShape
    limits: AttitudeLimits
    orbit: OrbitRanges
    steps: BlockSteps = BlockSteps()
    rule: str = "centre"

    def __post_init__(self) -> None:
        if self.rule not in RULES:
            raise BadInput("unknown rule for blocks", expected=" | ".join(RULES), got=self.rule)

    @property
    def dimensions(self) -> int:
        """As the band's."""
        return self.band.dimensions

    @cached_property
    def band(self) -> BandEnvelope:
        """The exact envelope."""
        return BandEnvelope(self.shape, self.limits, self.orbit)

    @cached_property
    def marked(self) -> NDArray[np.bool_]:
        """(180, 360) blocks by declination from the south pole and right ascension from 0h.

        A node turned by whole degrees turns the marks by as many blocks, so that the fields of one node do for all of them
        whose distance from it is whole; the others are stepped.
        """
        blocks = np.zeros((DEC_BLOCKS, RA_BLOCKS), bool)
        nodes = stepped(self.orbit.raan_rad, self.steps.raan_rad)
        rest = np.round(np.mod(np.degrees(nodes), 1.0), 6) % 1.0
        for part in np.unique(rest):
            own = self._marked_at(_deg(float(part)))
            for node in np.unique(np.round(np.degrees(nodes[rest == part]) - part).astype(int) % RA_BLOCKS):
                blocks |= np.roll(own, node, axis=1)
        return blocks

    def contains(self, unit: Array) -> NDArray[np.bool_]:
        """Which (n, 3) directions lie in marked blocks."""
        u = np.asarray(unit, float)
        ra = np.mod(np.arctan2(u[:, 1], u[:, 0]), 2 * np.pi)
        dec = np.arctan2(u[:, 2], np.hypot(u[:, 0], u[:, 1]))
        row = np.clip((dec + np.pi / 2) // BLOCK_RAD, 0, DEC_BLOCKS - 1).astype(int)
        return np.asarray(self.marked[row, np.clip(ra // BLOCK_RAD, 0, RA_BLOCKS - 1).astype(int)])

    def time_fraction(self, unit: Array) -> Array:
        """The band's share of time, in marked blocks only."""
        return np.asarray(np.where(self.contains(unit), self.band.time_fraction(unit), 0.0))

    def edges(self, at_end: bool) -> list[Array]:
        """The band's."""
        return self.band.edges(at_end)

    def attitudes(self, rng: np.random.Generator, count: int) -> Array:
        """The band's."""
        return self.band.attitudes(rng, count)

    def at(self, cube: Array) -> Moments:
        """The band's."""
        return self.band.at(cube)

    @property
    def fields(self) -> int:
        """How many fields the stepping looks at."""
        return len(self._attitudes(0.0)) * len(stepped(self.orbit.raan_rad, self.steps.raan_rad))

    def _attitudes(self, raan_rad: float) -> Array:
        """(n, 3, 3) cam_from_icrs of every combination at one node."""
        s, o = self.steps, self.orbit
        low, high = self.limits.low, self.limits.high
        steps = zip(low, high, (s.roll_rad, s.pitch_rad, s.yaw_rad), strict=True)
        boxes = [stepped((float(a), float(b)), step) for a, b, step in steps]
        angles = np.stack(np.meshgrid(*boxes, indexing="ij"), axis=-1).reshape(-1, 3)
        latitude = stepped((0.0, 2 * np.pi - 1e-6), s.latitude_rad)
        orbits = [
            orbit_axes(np.full(len(latitude), raan_rad), np.full(len(latitude), i), latitude)
            for i in stepped(o.inclination_rad, s.inclination_rad)
        ]
        cam = self.limits.cam_from_body @ euler_123(angles)
        return np.asarray((cam[:, None] @ np.concatenate(orbits)[None]).reshape(-1, 3, 3))

    def _marked_at(self, raan_rad: float) -> NDArray[np.bool_]:
        attitudes = self._attitudes(raan_rad)
        offsets = {"centre": [0.5], "whole": [0.0, 1.0], "touched": list(np.linspace(0, 1, TOUCH_GRID))}[self.rule]
        dec = np.arange(DEC_BLOCKS) - 90.0
        ra = np.arange(RA_BLOCKS) + 0.0
        points = []
        for up in offsets:
            for across in offsets:
                d, r = np.meshgrid(np.radians(dec + up), np.radians(ra + across), indexing="ij")
                unit = unit_from_ra_dec(r.ravel(), d.ravel())
                points.append(unit)
        if self.rule == "whole":
            return self._whole(attitudes, points)
        seen = [fields_per_star(unit, attitudes, self.shape) > 0 for unit in points]
        return np.asarray(np.logical_or.reduce(seen).reshape(DEC_BLOCKS, RA_BLOCKS))

    def _whole(self, attitudes: Array, corners: list[Array]) -> NDArray[np.bool_]:
        """Blocks with all corners in one and the same field."""
        blocks = np.zeros(DEC_BLOCKS * RA_BLOCKS, bool)
        for cam in attitudes:
            near = np.flatnonzero(corners[0] @ cam[2] >= np.cos(self.shape.half_diagonal_rad + BLOCK_RAD))
            near = near[~blocks[near]]
            inside = np.logical_and.reduce([self.shape.inside(c[near] @ cam.T) for c in corners])
            blocks[near[inside]] = True
        return blocks.reshape(DEC_BLOCKS, RA_BLOCKS)
