"""Interface of the on-board chains: three stages, which are commands of the device, with parameters and durations.

The simulator's firmware, the ground replay and ``gss solve`` run chains only through this interface. Equal frame, bank,
settings and prior therefore give bit-identical results in all three.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from gss.domain.angles import Array
from gss.domain.camera import Camera
from gss.domain.camera_profile import CameraProfile
from gss.domain.errors import BadInput
from gss.domain.results import Attitude, Centroids, Matches, Outcome, Region, SolveResult
from gss.pipeline.chains.modes import AttitudePrior, Mode
from gss.pipeline.regions import Pixels
from gss.pipeline.trace import Trace
from gss.skytables.bank import OnboardCatalogue


@dataclass(frozen=True)
class Detection:
    """Result of FIND_CENTROIDS. ``regions``: in order of discovery, ``centroids``: brightest first, limited to the
    number the system keeps; ``invalid``: number of regions that are too large; ``black_dn``: reference level of the
    threshold."""

    regions: tuple[Region, ...]
    centroids: Centroids
    invalid: int
    black_dn: float
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class OnboardSolution:
    """Result of CALCULATE_ATTITUDE. ``attitude`` and ``matches`` are None with a ``reason``. ``false_match_probability``: bound on
    the probability of an accidental identification of this quality; NaN if nothing was identified."""

    attitude: Attitude | None
    matches: Matches | None
    false_match_probability: float
    reason: str


class Matched(Protocol):
    """Result of MATCH_STARS. ``row``: (n,) catalogue row per centroid used, −1 if not identified. ``selected``: indices of the
    centroids used for the attitude, empty with a ``reason``. ``weight``: (n,) weight in the attitude. ``operations``:
    number of table look-ups or comparisons. ``confidence``: 0–1."""

    @property
    def mode(self) -> Mode: ...
    @property
    def row(self) -> NDArray[np.integer]: ...
    @property
    def selected(self) -> NDArray[np.integer]: ...
    @property
    def weight(self) -> Array: ...
    @property
    def operations(self) -> int: ...
    @property
    def confidence(self) -> float: ...
    @property
    def reason(self) -> str: ...


@dataclass(frozen=True)
class Commanded:
    """Values that the operator can set on board. If a value is None, the chain's value is used. ``threshold_dn`` is above black."""

    threshold_dn: float | None = None
    min_area_px: int | None = None
    max_area_px: int | None = None
    hint_radius_rad: float | None = None


P = TypeVar("P")


def with_detection(base: P, commanded: Commanded) -> P:
    """Return a chain's parameters with the commanded threshold and areas. The maximum area is never below the minimum."""
    current: Any = base
    smallest = current.min_area_px if commanded.min_area_px is None else commanded.min_area_px
    largest = current.max_area_px if commanded.max_area_px is None else commanded.max_area_px
    threshold_dn = current.threshold_dn if commanded.threshold_dn is None else float(commanded.threshold_dn)
    changed: P = replace(current, threshold_dn=threshold_dn, min_area_px=smallest, max_area_px=max(largest, smallest))
    return changed


def with_commanded(base: P, camera: Camera, commanded: Commanded, mode: Mode) -> P:
    """Return a chain's parameters with all commanded values. See :func:`with_detection`; in assisted mode, the
    catalogue radius is the field's half diagonal plus the hint's radius."""
    changed: Any = with_detection(base, commanded)
    if mode is Mode.ASSISTED and commanded.hint_radius_rad is not None:
        reach_rad = min(float(np.pi), camera.half_diagonal_rad + commanded.hint_radius_rad)
        changed = replace(changed, assisted_radius_rad=reach_rad)
    result: P = changed
    return result


@dataclass(frozen=True)
class Work:
    """Input for processing one frame: ``catalogue`` from ``prepare``, ``parameters`` from ``parameters``, the ``mode`` and,
    unless lost in space, the ``hint``. ``dark``: (rows, n) pixels of the detector's dark columns, None if the frame has none."""

    camera: Camera
    catalogue: Any
    parameters: Any
    mode: Mode = Mode.LOST_IN_SPACE
    hint: AttitudePrior | None = None
    dark: Pixels | None = None


class OnboardChain(Protocol):
    """The complete chain of one system. All methods are pure."""

    @property
    def name(self) -> str: ...

    @property
    def oldest_attitude_s(self) -> float:
        """Return the maximum age of the last attitude at a frame that is tracked from it."""

    def parameters(self, profile: CameraProfile, exposure_s: float | None, commanded: Commanded, mode: Mode) -> Any:
        """Return the chain's constants for a camera, with the commanded values."""

    def prepare(self, catalogue: OnboardCatalogue, profile: CameraProfile) -> Any:
        """Return the bank in the form that the processor prepares after reading it: the bank itself, or tables derived
        from the bank."""

    def find_centroids(self, pixels: Pixels, work: Work) -> Detection:
        """Find the stars in a (rows, columns) frame."""

    def match_stars(self, centroids: Centroids, work: Work) -> Any:
        """Identify centroids; returns a ``Matched``."""

    def calculate_attitude(self, matching: Any, centroids: Centroids, work: Work) -> OnboardSolution:
        """Compute the attitude from a ``Matched``, or the reason why there is none."""

    def next_mode(self, mode: Mode, solved: bool) -> Mode:
        """Return the mode of the next iteration."""

    def detect_ms(self, pixels: int, detection: Detection) -> float:
        """Return the duration of the detection on the system's processor, from the document's times and the counted operations."""

    def match_ms(self, matching: Any) -> float:
        """Return the duration of the matching; see ``detect_ms``."""

    def attitude_ms(self, matching: Any) -> float:
        """Return the duration of the attitude computation; see ``detect_ms``."""


def solve(
    chain: OnboardChain,
    pixels: Pixels,
    work: Work,
    clock: Callable[[], float] | None = None,
    trace: Trace | None = None,
) -> SolveResult:
    """Process one frame from pixels to attitude, with exactly the steps that the device offers as commands."""
    camera = work.camera
    if pixels.shape != (camera.rows, camera.columns):
        raise BadInput(
            "frame does not fit the camera",
            expected=f"{camera.rows} rows x {camera.columns} columns",
            got=" x ".join(map(str, pixels.shape)),
        )
    stages = trace if trace is not None else Trace(clock)
    with stages.stage("detect"):
        detection = chain.find_centroids(pixels, work)
    stages.keep("detection", detection)
    with stages.stage("match"):
        matching = chain.match_stars(detection.centroids, work)
    stages.keep("matching", matching)
    with stages.stage("attitude"):
        solution = chain.calculate_attitude(matching, detection.centroids, work)
    return SolveResult(
        chain.name,
        Outcome.SOLVED if solution.attitude is not None else Outcome.NONE,
        solution.reason,
        camera,
        detection.regions,
        detection.centroids,
        solution.matches,
        solution.attitude,
        solution.false_match_probability,
        dict(stages.timing_s),
        detection.notes,
    )
