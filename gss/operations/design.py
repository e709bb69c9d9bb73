"""The design desk: a camera edited on the page or the terminal, looked at quickly, then counted in full as a job."""

from __future__ import annotations

import time
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np

from gss.catalogue_tools.attitude import ORBIT_LAWS, AttitudeLimits
from gss.catalogue_tools.design.camera import DesignCamera, design_camera, document_cameras
from gss.catalogue_tools.design.report import EXCLUSION_RAD, FULL, QUICK, DesignRequest, camera_row, design
from gss.catalogue_tools.design.trade import TradeRow
from gss.catalogue_tools.envelope import BandEnvelope, Envelope
from gss.catalogue_tools.orbits import Range, from_elements
from gss.domain.errors import BadInput
from gss.domain.stars import StarTable
from gss.operations.design_record import record_of
from gss.operations.jobs import JobService, Progress
from gss.store.models import Job

STEPS = 100
WORKERS = 2
CAMERA_LOOKS, CAMERA_PAIRS = 1500, 3e4


@dataclass(frozen=True)
class Along:
    """An orbit and a law of pointing with its limits, in place of the whole sky."""

    inclination_rad: Range
    raan_rad: Range
    pointing: str
    roll_rad: Range = (0.0, 0.0)
    pitch_rad: Range = (0.0, 0.0)
    yaw_rad: Range = (0.0, 0.0)


@dataclass(frozen=True)
class Question:
    """``profile``: the camera to start from; ``changes``: fields of :class:`DesignCamera` with other values. ``exclusion_rad``
    None: 40°. ``along`` None: the whole sky."""

    profile: str
    changes: Mapping[str, float]
    exclusion_rad: float | None = None
    spare_mm: float = 0.0
    along: Along | None = None
    seed: int = 1


def request_of(question: Question) -> DesignRequest:
    """The edited camera and where it looks; BadInput where that cannot be."""
    camera = design_camera(question.profile).edited(**question.changes)
    exclusion = EXCLUSION_RAD if question.exclusion_rad is None else question.exclusion_rad
    if not 0 <= question.spare_mm <= 1000:
        raise BadInput(
            "the baffle's spare width is out of range", expected="0 to 1000 mm", got=f"{question.spare_mm:g}"
        )
    return DesignRequest(
        camera, _envelope(camera, question.along), float(exclusion), float(question.spare_mm), question.seed
    )


def _envelope(camera: DesignCamera, along: Along | None) -> Envelope | None:
    if along is None:
        return None
    if along.pointing not in ORBIT_LAWS:
        raise BadInput(
            "this pointing law does not follow an orbit", expected=" | ".join(ORBIT_LAWS), got=along.pointing
        )
    limits = AttitudeLimits(along.pointing, along.roll_rad, along.pitch_rad, along.yaw_rad)
    return BandEnvelope(camera.shape, limits, from_elements(along.inclination_rad, along.raan_rad))


class DesignService:
    """Answers questions about cameras; the documents' own lines are reckoned once."""

    def __init__(self, jobs: JobService, stars: StarTable) -> None:
        self._jobs, self._stars = jobs, stars
        self._rows: dict[DesignCamera, TradeRow] = {}

    def quick(self, question: Question) -> dict[str, Any]:
        """The quick look: a record with fewer pointings and no lens trade."""
        start_s = time.perf_counter()
        report = design(request_of(question), self._stars, QUICK)
        record = record_of(report, question.profile, self._cameras(report.request.camera))
        return record | {"elapsed_ms": 1000 * (time.perf_counter() - start_s)}

    def full(self, question: Question, progress: Progress = lambda *_: None) -> dict[str, Any]:
        """A million pointings and the lens trade."""
        start_s = time.perf_counter()
        with ThreadPoolExecutor(WORKERS, thread_name_prefix="design") as pool:
            report = design(
                request_of(question),
                self._stars,
                FULL,
                each=pool.map,
                progress=lambda share: progress(round(share * STEPS), STEPS, "counting stars in fields"),
            )
        record = record_of(report, question.profile, self._cameras(report.request.camera))
        return record | {"elapsed_ms": 1000 * (time.perf_counter() - start_s)}

    def start(self, question: Question, asked: Mapping[str, Any]) -> Job:
        """The full count as a job; its result is the record. An impossible camera is told at once."""
        request_of(question)

        def work(progress: Progress) -> dict[str, Any]:
            return {"design": self.full(question, progress)}

        return self._jobs.submit("design", f"design {question.profile}", dict(asked), work)

    def document_rows(self) -> tuple[TradeRow, ...]:
        """The documents' cameras, each as its profile has it."""
        return tuple(self._row(c) for c in document_cameras())

    def _cameras(self, edited: DesignCamera) -> tuple[TradeRow, ...]:
        """The documents' cameras, and this one first unless it is one of them."""
        fixed = self.document_rows()
        return fixed if edited in document_cameras() else (self._row(edited), *fixed)

    def _row(self, camera: DesignCamera) -> TradeRow:
        if camera not in self._rows:
            row = camera_row(camera, self._stars, CAMERA_LOOKS, CAMERA_PAIRS)
            if camera not in document_cameras():
                return row
            self._rows[camera] = row
        return self._rows[camera]


def radians(limits: tuple[float, float] | list[float]) -> Range:
    """Two degrees as the record has them."""
    return float(np.radians(limits[0])), float(np.radians(limits[1]))
