"""Requests for calibrations of stored frames, validated before anything is queued."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from gss.domain.errors import BadInput
from gss.operations.studies import bench
from gss.operations.studies.calibrate import check_models

MOST_FRAMES = 2000


@dataclass(frozen=True)
class StarCalibration:
    """Calibrate from frames of stars. ``profile`` "": an unknown camera, solved blind. ``models``: lens models to choose
    from, all if empty. ``prior_ids``: bench calibrations used as priors."""

    frame_ids: tuple[int, ...]
    profile: str = ""
    models: tuple[str, ...] = ()
    photometry: bool = True
    psf: bool = True
    fov_rad: float | None = None
    prior_ids: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        check_models(self.models)
        check_frames("frames", self.frame_ids, 1)


@dataclass(frozen=True)
class DetectorCalibration:
    """Calibrate the detector from dark frames of one exposure and, optionally, pairs of flat fields."""

    profile: str
    dark_ids: tuple[int, ...]
    flat_pairs: tuple[tuple[int, int], ...] = ()

    def __post_init__(self) -> None:
        check_frames("dark frames", self.dark_ids, 3)


@dataclass(frozen=True)
class BenchCalibration:
    """Run one bench method. ``kind``: one of ``bench.KINDS``; ``rows``: measurements (positions of dots, temperatures and
    dark currents, settings and widths); ``frame_ids``: pictures, in the order of ``positions`` for a focus run; ``options``:
    corners, square_mm, fit_k3, radius_px, order, wished_sigma_px, depending on the method."""

    kind: str
    profile: str
    rows: tuple[tuple[float, ...], ...] = ()
    frame_ids: tuple[int, ...] = ()
    positions: tuple[float, ...] = ()
    options: tuple[tuple[str, Any], ...] = ()

    def __post_init__(self) -> None:
        if self.kind not in bench.KINDS:
            raise BadInput("unknown method of the bench", expected=" | ".join(bench.KINDS), got=self.kind)
        pictures = self.kind in ("bench-focal", "bench-radial", "bench-checkerboard")
        if pictures or (self.kind == "bench-focus" and not self.rows):
            check_frames("frames", self.frame_ids, 1)
        elif not self.rows:
            raise BadInput(f"nothing was measured for {self.kind}", expected="rows of numbers")


Wanted = StarCalibration | DetectorCalibration | BenchCalibration


def check_frames(what: str, ids: Sequence[int], fewest: int) -> None:
    """Raise BadInput if there are too few or too many frames, or duplicates."""
    if not fewest <= len(ids) <= MOST_FRAMES or len(set(ids)) != len(ids):
        raise BadInput(
            f"{what} cannot be used",
            expected=f"{fewest} to {MOST_FRAMES}, each once",
            got=f"{len(ids)}, {len(set(ids))} different",
        )


def frames_of(wanted: Wanted) -> tuple[int, ...]:
    """Return the frames of a calibration, without flat fields."""
    return wanted.dark_ids if isinstance(wanted, DetectorCalibration) else wanted.frame_ids


def as_plain(wanted: Wanted) -> dict[str, Any]:
    """Return the request as stored plain values."""

    def plain(value: Any) -> Any:
        return [plain(v) for v in value] if isinstance(value, tuple) else value

    return {k: dict(v) if k == "options" else plain(v) for k, v in vars(wanted).items()}


def from_plain(kind: str, record: Mapping[str, Any]) -> Wanted:
    """Restore a request from its stored values; ``kind`` is the name of its class."""
    classes: Any = {made.__name__: made for made in (StarCalibration, DetectorCalibration, BenchCalibration)}

    def tuples(value: Any) -> Any:
        return tuple(tuples(v) for v in value) if isinstance(value, list) else value

    values = {k: tuple(v.items()) if k == "options" else tuples(v) for k, v in record.items()}
    made: Wanted = classes[kind](**values)
    return made
