"""Solves photographs of an unknown camera blind, and selects sharp photographs of one camera."""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from gss.domain.errors import BadInput
from gss.domain.results import Outcome, SolveResult
from gss.domain.words import counted
from gss.operations.frames.frames import Pixels
from gss.operations.frames.solve import Solver, SolveRequest
from gss.operations.studies.night_frames import ProgressCallback, Shot, matched_stars, request_of
from gss.pipeline.calibration.screening import SCALE_GAP, STREAK_PX
from gss.pipeline.calibration.sightings import FrameStars

FEWEST = 3
"""Minimum number of solved photographs for a calibration. Cross-validation needs three photographs."""
MIN_SPOTS = 5
MAX_REASONS = 20


@dataclass(frozen=True)
class Photograph:
    """A readable photograph. ``file``: metadata of its file."""

    shot: Shot
    file: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class PhotographRow:
    """Result for one file. ``reason``: why it was not used; ``spots``: number of detected stars; ``matched``: number of
    identified stars; ``fov_deg``: horizontal field of view of this photograph solved alone; ``rms_px``: residual."""

    name: str
    used: bool
    reason: str = ""
    spots: int = 0
    matched: int = 0
    fov_deg: float | None = None
    rms_px: float | None = None


@dataclass(frozen=True)
class SolvedPhotograph:
    """A photograph with its solution and identified stars."""

    photograph: Photograph
    result: SolveResult
    stars: FrameStars

    @property
    def name(self) -> str:
        """Name of the file."""
        return self.photograph.shot.name


@dataclass(frozen=True)
class SortedPhotographs:
    """At least three photographs of one camera, and a row for every given file."""

    used: tuple[SolvedPhotograph, ...]
    rows: tuple[PhotographRow, ...]


class _Sorting:
    """Collects the rows of the files while photographs are rejected."""

    def __init__(self, unreadable: Sequence[PhotographRow]) -> None:
        self.rows = {row.name: row for row in unreadable}

    def reject(self, name: str, reason: str, result: SolveResult | None = None) -> None:
        self.rows[name] = _row(name, result, reason)

    def check(self, remaining: int) -> None:
        """Raise BadInput with a reason for each file if fewer than FEWEST photographs remain."""
        if remaining >= FEWEST:
            return
        reasons = [f"{row.name}: {row.reason}" for row in self.rows.values() if row.reason]
        unlisted = len(reasons) - MAX_REASONS
        listed = "\n".join([*reasons[:MAX_REASONS], *([f"and {unlisted} more"] if unlisted > 0 else [])])
        raise BadInput(
            "no camera can be calibrated from these photographs",
            expected=f"at least {FEWEST} photographs of one camera that can be solved, preferably 20",
            got=f"{remaining}\n{listed}" if listed else str(remaining),
            hint="use sharp photographs of the night sky in the camera's full size; state the field of view if you know it",
        )


def sort_out(
    solver: Solver,
    photographs: Sequence[Photograph],
    unreadable: Sequence[PhotographRow],
    fov_limits_rad: tuple[float, float] | None,
    progress: ProgressCallback,
) -> SortedPhotographs:
    """Solve the photographs blind and select the photographs of one camera. ``unreadable``: files without an image.
    Raises BadInput with a reason for each file if fewer than three photographs remain."""
    sorting = _Sorting(unreadable)
    remaining = _of_most_common_size(_without_copies(photographs, sorting), sorting)
    sorting.check(len(remaining))
    solved = _solved(solver, remaining, fov_limits_rad, sorting, progress)
    sorting.check(len(solved))
    solved = _sharp(_of_one_scale(solved, sorting), sorting)
    sorting.check(len(solved))
    for used in solved:
        sorting.rows[used.name] = replace(_row(used.name, used.result, ""), used=True)
    return SortedPhotographs(tuple(solved), tuple(sorting.rows[name] for name in sorted(sorting.rows)))


def _row(name: str, result: SolveResult | None, reason: str) -> PhotographRow:
    if result is None:
        return PhotographRow(name, False, reason)
    solved = result.outcome is Outcome.SOLVED
    return PhotographRow(
        name,
        False,
        reason,
        len(result.centroids),
        len(result.matches) if result.matches is not None else 0,
        float(np.degrees(result.camera.fov_rad[0])) if solved else None,
        result.residual_rms_px if solved else None,
    )


def _without_copies(photographs: Sequence[Photograph], sorting: _Sorting) -> list[Photograph]:
    """Return the photographs without duplicates. A duplicate would be treated as an independent measurement."""
    name_by_key: dict[str, str] = {}
    different = []
    for photograph in photographs:
        name, pixels = photograph.shot.name, np.ascontiguousarray(photograph.shot.pixels())
        key = hashlib.sha256(pixels.data.cast("B")).hexdigest()
        if key in name_by_key:
            sorting.reject(name, f"the same pixels as {name_by_key[key]}")
            continue
        name_by_key[key] = name
        different.append(photograph)
    return different


def _of_most_common_size(photographs: list[Photograph], sorting: _Sorting) -> list[Photograph]:
    sizes = [photograph.shot.pixels().shape for photograph in photographs]
    if not sizes:
        return []
    ranking = Counter(sizes).most_common(2)
    (rows, columns), most_common_count = ranking[0]
    tied = len(ranking) == 2 and ranking[1][1] == most_common_count
    same_size = []
    for photograph, size in zip(photographs, sizes, strict=True):
        if size == (rows, columns) and not tied:
            same_size.append(photograph)
            continue
        size_text = f"{size[1]} x {size[0]} px"
        comparison = (
            "no size is more frequent than the others"
            if tied
            else f"{most_common_count} others are {columns} x {rows} px"
        )
        sorting.reject(photograph.shot.name, f"{size_text}; {comparison}: cropped, resized, or of another camera")
    return same_size


def _solved(
    solver: Solver,
    photographs: list[Photograph],
    fov_limits_rad: tuple[float, float] | None,
    sorting: _Sorting,
    progress: ProgressCallback,
) -> list[SolvedPhotograph]:
    """Solve each photograph. The field of view of the last solved photograph is tried first, which saves most of the
    time."""
    solved: list[SolvedPhotograph] = []
    for k, photograph in enumerate(photographs):
        shot = photograph.shot
        progress(k / len(photographs), f"{shot.name}, {k + 1} of {len(photographs)}, {len(solved)} solved")
        pixels = shot.pixels()
        blind = replace(request_of(shot, None, None, "reference"), fov_limits_rad=fov_limits_rad)
        result = _solve(solver, pixels, blind, solved[-1].result.camera.fov_rad[0] if solved else None)
        stars = matched_stars(solver, shot, pixels, result, None)
        if stars is None:
            too_few = len(result.centroids) < MIN_SPOTS
            reason = f"{result.reason}: not the night sky, or exposed too short" if too_few else result.reason
            sorting.reject(shot.name, reason, result)
        else:
            solved.append(SolvedPhotograph(photograph, result, stars))
    return solved


def _solve(solver: Solver, pixels: Pixels, blind: SolveRequest, fov_rad: float | None) -> SolveResult:
    if fov_rad is not None:
        result = solver.solve(pixels, replace(blind, blind=False, fov_limits_rad=None, fov_rad=fov_rad))
        if result.attitude is not None or len(result.centroids) < MIN_SPOTS:
            return result
    return solver.solve(pixels, blind)


def _of_one_scale(solved: list[SolvedPhotograph], sorting: _Sorting) -> list[SolvedPhotograph]:
    """Return the largest group of photographs without a gap in their focal lengths. All other photographs are of
    another camera, or were cropped and enlarged."""
    focal = np.array([s.result.camera.focal_col_px for s in solved])
    order = np.argsort(focal)
    groups = np.split(order, np.flatnonzero(np.diff(np.log(focal[order])) > SCALE_GAP) + 1)
    largest = max(groups, key=len)
    tied = [g for g in groups if len(g) == len(largest)]
    typical = float(np.median([np.degrees(solved[k].result.camera.fov_rad[0]) for k in largest]))
    same_scale = set() if len(tied) > 1 else set(largest.tolist())
    for k, s in enumerate(solved):
        if k not in same_scale:
            field_text = f"field of view {np.degrees(s.result.camera.fov_rad[0]):.2f}°"
            comparison = (
                "as many photographs have another field of view"
                if len(tied) > 1
                else f"most others have {typical:.2f}°"
            )
            sorting.reject(
                s.name, f"{field_text}; {comparison}: another camera or lens, or cropped and enlarged", s.result
            )
    return [s for k, s in enumerate(solved) if k in same_scale]


def _sharp(solved: list[SolvedPhotograph], sorting: _Sorting) -> list[SolvedPhotograph]:
    for s in solved:
        if s.stars.streak_px > STREAK_PX:
            reason = f"the stars are trails of {s.stars.streak_px:.0f} px: fix the camera, or expose shorter"
            sorting.reject(s.name, reason, s.result)
    return [s for s in solved if s.stars.streak_px <= STREAK_PX]


def without(sorted_out: SortedPhotographs, excluded: Mapping[str, str]) -> SortedPhotographs:
    """Return the photographs without the excluded photographs. ``excluded``: reason by name. Raises BadInput if fewer
    than three photographs remain."""
    sorting = _Sorting(sorted_out.rows)
    for name, reason in excluded.items():
        sorting.rows[name] = replace(sorting.rows[name], used=False, reason=reason)
    used = tuple(s for s in sorted_out.used if s.name not in excluded)
    sorting.check(len(used))
    return SortedPhotographs(used, tuple(sorting.rows.values()))


def words_of(rows: Sequence[PhotographRow]) -> str:
    """Return the number of used files as text."""
    return f"{sum(row.used for row in rows)} of {counted(len(rows), 'photograph')}"
