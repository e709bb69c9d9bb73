"""The block method of Jacobs 1995 §5.2.1 for a sub-catalogue: step through all angles, mark blocks of sky, select the
stars in marked blocks.

This replica shows which stars the method misses compared with the exact envelope. The document does not state the steps
and does not define when a block is "included within the FOV". Here both are parameters.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from gss.catalogue_tools.envelope.attitude import AttitudeLimits, euler_123, orbit_axes
from gss.catalogue_tools.envelope.envelope import BandEnvelope
from gss.catalogue_tools.envelope.field import FieldShape
from gss.catalogue_tools.envelope.moments import Moments
from gss.catalogue_tools.envelope.orbits import OrbitRanges, Range
from gss.catalogue_tools.selection.counting import fields_per_star
from gss.domain.angles import Array, unit_from_ra_dec
from gss.domain.errors import BadInput

RULES = ("centre", "whole", "touched")
RA_BLOCKS, DEC_BLOCKS = 360, 180
BLOCK_RAD = float(np.radians(1.0))
# Points that represent a block: its centre, its corners, or a grid over it.
TOUCH_GRID = 5
TURN: Range = (0.0, 2 * np.pi - 1e-6)
# Number of fields computed together. It limits the memory, because a field needs about 100 bytes.
CHUNK = 1000

ShareReport = Callable[[float], None]


def _silent(share: float) -> None:
    """Ignore the progress."""


def _deg(value: float) -> float:
    return float(np.radians(value))


@dataclass(frozen=True)
class BlockSteps:
    """Increments of the six variables of Jacobs 1995 Table 5-2, from minimum to maximum. The document does not state
    them."""

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
    """Return the values from the minimum to the maximum in steps. As in a FOR loop, the maximum is included only if the
    range is a multiple of the step."""
    low, high = limits
    return np.asarray(low + step_rad * np.arange(int(np.floor((high - low) / step_rad + 1e-9)) + 1), float)


@dataclass(frozen=True)
class BlockEnvelope:
    """An envelope that consists of marked blocks.

    ``rule``: a block is marked if its centre, its whole area or any part of it is in the field. ``report`` is called
    with the fraction done while blocks are marked. It can raise an exception to cancel. Edges, fractions of time and
    attitudes are those of the exact band.
    """

    shape: FieldShape
    limits: AttitudeLimits
    orbit: OrbitRanges
    steps: BlockSteps = BlockSteps()
    rule: str = "centre"
    report: ShareReport = field(default=_silent, compare=False, repr=False)

    def __post_init__(self) -> None:
        if self.rule not in RULES:
            raise BadInput("unknown rule for blocks", expected=" | ".join(RULES), got=self.rule)

    @property
    def dimensions(self) -> int:
        """Same as :attr:`BandEnvelope.dimensions`."""
        return self.band.dimensions

    @cached_property
    def band(self) -> BandEnvelope:
        """The exact envelope."""
        return BandEnvelope(self.shape, self.limits, self.orbit)

    @cached_property
    def marked(self) -> NDArray[np.bool_]:
        """(180, 360) mask of blocks by declination from the south pole and right ascension from 0h.

        A shift of the node by whole degrees shifts the marks by the same number of blocks. Therefore the fields of one
        node are reused for all nodes that are a whole number of degrees away. Fields are stepped for the remaining
        nodes.
        """
        blocks = np.zeros((DEC_BLOCKS, RA_BLOCKS), bool)
        nodes, node_parts = stepped(self.orbit.raan_rad, self.steps.raan_rad), self._node_parts
        done, total = 0, self.looked_at

        def count(fields: int) -> None:
            nonlocal done
            done += fields
            self.report(done / total)

        for part in np.unique(node_parts):
            at_first_node = self._marked_at(_deg(float(part)), count)
            for node in np.unique(np.round(np.degrees(nodes[node_parts == part]) - part).astype(int) % RA_BLOCKS):
                blocks |= np.roll(at_first_node, node, axis=1)
        return blocks

    def contains(self, unit: Array) -> NDArray[np.bool_]:
        """Return the (n,) mask of the (n, 3) directions in marked blocks."""
        u = np.asarray(unit, float)
        ra = np.mod(np.arctan2(u[:, 1], u[:, 0]), 2 * np.pi)
        dec = np.arctan2(u[:, 2], np.hypot(u[:, 0], u[:, 1]))
        row = np.clip((dec + np.pi / 2) // BLOCK_RAD, 0, DEC_BLOCKS - 1).astype(int)
        return np.asarray(self.marked[row, np.clip(ra // BLOCK_RAD, 0, RA_BLOCKS - 1).astype(int)])

    def time_fraction(self, unit: Array) -> Array:
        """The band's fraction of time, in marked blocks only."""
        return np.asarray(np.where(self.contains(unit), self.band.time_fraction(unit), 0.0))

    def edges(self, at_end: bool) -> list[Array]:
        """Same as :meth:`BandEnvelope.edges`."""
        return self.band.edges(at_end)

    def attitudes(self, rng: np.random.Generator, count: int) -> Array:
        """Same as :meth:`BandEnvelope.attitudes`."""
        return self.band.attitudes(rng, count)

    def at(self, cube: Array) -> Moments:
        """Same as :meth:`BandEnvelope.at`."""
        return self.band.at(cube)

    @property
    def fields(self) -> int:
        """Number of fields of the stepping."""
        return self._fields_at_node * len(stepped(self.orbit.raan_rad, self.steps.raan_rad))

    @property
    def looked_at(self) -> int:
        """Number of fields that are computed. Nodes that are a whole number of degrees apart share their fields."""
        return self._fields_at_node * len(np.unique(self._node_parts))

    @property
    def _node_parts(self) -> Array:
        """(n,) fractional part of each node in degrees."""
        nodes = stepped(self.orbit.raan_rad, self.steps.raan_rad)
        return np.asarray(np.round(np.mod(np.degrees(nodes), 1.0), 6) % 1.0)

    @property
    def _fields_at_node(self) -> int:
        latitudes = len(stepped(TURN, self.steps.latitude_rad))
        inclinations = len(stepped(self.orbit.inclination_rad, self.steps.inclination_rad))
        return int(np.prod([len(box) for box in self._boxes])) * latitudes * inclinations

    @property
    def _boxes(self) -> list[Array]:
        """Return the steps of roll, pitch and yaw, one array for each angle."""
        s = self.steps
        steps = zip(self.limits.low, self.limits.high, (s.roll_rad, s.pitch_rad, s.yaw_rad), strict=True)
        return [stepped((float(a), float(b)), step) for a, b, step in steps]

    def _attitudes(self, raan_rad: float) -> Iterator[Array]:
        """Yield (n, 3, 3) cam_from_icrs of all combinations at one node, at most CHUNK together."""
        s, o = self.steps, self.orbit
        boxes = self._boxes
        angles = np.stack(np.meshgrid(*boxes, indexing="ij"), axis=-1).reshape(-1, 3)
        latitude = stepped(TURN, s.latitude_rad)
        orbits = np.concatenate(
            [
                orbit_axes(np.full(len(latitude), raan_rad), np.full(len(latitude), i), latitude)
                for i in stepped(o.inclination_rad, s.inclination_rad)
            ]
        )
        per_chunk = max(1, CHUNK // len(orbits))
        for start in range(0, len(angles), per_chunk):
            cam = self.limits.cam_from_body @ euler_123(angles[start : start + per_chunk])
            yield (cam[:, None] @ orbits[None]).reshape(-1, 3, 3)

    def _marked_at(self, raan_rad: float, report: Callable[[int], None]) -> NDArray[np.bool_]:
        """Mark the blocks for one node. ``report`` is called with the number of fields after each chunk."""
        offsets = {"centre": [0.5], "whole": [0.0, 1.0], "touched": list(np.linspace(0, 1, TOUCH_GRID))}[self.rule]
        dec = np.arange(DEC_BLOCKS) - 90.0
        ra = np.arange(RA_BLOCKS) + 0.0
        points = []
        for up in offsets:
            for across in offsets:
                d, r = np.meshgrid(np.radians(dec + up), np.radians(ra + across), indexing="ij")
                unit = unit_from_ra_dec(r.ravel(), d.ravel())
                points.append(unit)
        blocks = np.zeros(DEC_BLOCKS * RA_BLOCKS, bool)
        for attitudes in self._attitudes(raan_rad):
            if blocks.all():
                pass  # all blocks are marked; continue only to report the progress
            elif self.rule == "whole":
                self._mark_whole(blocks, attitudes, points)
            else:
                for unit in points:
                    # Only unmarked blocks need to be tested.
                    unmarked = np.flatnonzero(~blocks)
                    blocks[unmarked[fields_per_star(unit[unmarked], attitudes, self.shape) > 0]] = True
            report(len(attitudes))
        return blocks.reshape(DEC_BLOCKS, RA_BLOCKS)

    def _mark_whole(self, blocks: NDArray[np.bool_], attitudes: Array, corners: list[Array]) -> None:
        """Mark the blocks whose corners are all in the same field."""
        for cam in attitudes:
            near = np.flatnonzero(corners[0] @ cam[2] >= np.cos(self.shape.half_diagonal_rad + BLOCK_RAD))
            near = near[~blocks[near]]
            inside = np.logical_and.reduce([self.shape.inside(c[near] @ cam.T) for c in corners])
            blocks[near[inside]] = True
