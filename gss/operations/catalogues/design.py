"""Camera design: a camera edited on the page or in the terminal, evaluated quickly, then in full as a job."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from gss.catalogue_tools.design.camera import DesignCamera, design_camera, document_cameras
from gss.catalogue_tools.design.report import EXCLUSION_RAD, FULL, QUICK, DesignRequest, camera_row, design
from gss.catalogue_tools.design.trade import TradeRow
from gss.catalogue_tools.envelope.attitude import ORBIT_LAWS, AttitudeLimits
from gss.catalogue_tools.envelope.envelope import BandEnvelope, Envelope
from gss.catalogue_tools.envelope.orbits import Range, from_elements
from gss.domain.errors import BadInput
from gss.domain.stars import StarTable
from gss.operations.catalogues.design_curves import short
from gss.operations.catalogues.design_record import record_of
from gss.operations.jobs import JobService, Progress, Resumable, Run
from gss.store.models import Job

STEPS = 100
WORKERS = 2
FEWEST, MOST = 1_000, 10_000_000
CAMERA_LOOKS, CAMERA_PAIRS = 1500, 3e4


@dataclass(frozen=True)
class Along:
    """An orbit and a pointing law with its limits, instead of the whole sky."""

    inclination_rad: Range
    raan_rad: Range
    pointing: str
    roll_rad: Range = (0.0, 0.0)
    pitch_rad: Range = (0.0, 0.0)
    yaw_rad: Range = (0.0, 0.0)


@dataclass(frozen=True)
class Question:
    """A design request. ``profile``: the initial camera; ``changes``: changed fields of :class:`DesignCamera`.
    ``exclusion_rad`` None: 40°. ``along`` None: the whole sky. ``pointings``: of the full evaluation."""

    profile: str
    changes: Mapping[str, float]
    exclusion_rad: float | None = None
    spare_mm: float = 0.0
    along: Along | None = None
    seed: int = 1
    pointings: int = FULL.pointings


def request_of(question: Question) -> DesignRequest:
    """Return the edited camera and its pointing envelope. Raises BadInput if they are impossible."""
    camera = design_camera(question.profile).edited(**question.changes)
    exclusion = EXCLUSION_RAD if question.exclusion_rad is None else question.exclusion_rad
    if not FEWEST <= question.pointings <= MOST:
        raise BadInput("pointings are out of range", expected=f"{FEWEST} to {MOST}", got=str(question.pointings))
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


def answer(
    question: Question,
    stars: StarTable,
    *,
    quick: bool = False,
    documents: tuple[TradeRow, ...] | None = None,
    progress: Progress = lambda *_: None,
) -> dict[str, Any]:
    """Return the record of one design: quick, or with full pointings and the lens trade. ``documents``: rows of the
    documents' cameras, if already computed."""
    start_s = time.perf_counter()
    request = request_of(question)
    if quick:
        report = design(request, stars, QUICK)
    else:
        effort = replace(FULL, pointings=question.pointings, looks=min(FULL.looks, question.pointings))
        pool = ThreadPoolExecutor(WORKERS, thread_name_prefix="design")
        try:
            report = design(request, stars, effort, each=pool.map, progress=_by_percent(progress))
        finally:
            # After a cancel, queued work must not be run first.
            pool.shutdown(wait=True, cancel_futures=True)
    fixed = document_rows(stars) if documents is None else documents
    mine = () if request.camera in [r.camera for r in fixed] else (_row(request.camera, stars),)
    record = record_of(report, question.profile, (*mine, *fixed))
    return record | {"elapsed_ms": short(1000 * (time.perf_counter() - start_s))}


def document_rows(stars: StarTable) -> tuple[TradeRow, ...]:
    """Return the rows of the documents' cameras, as in their profiles."""
    return tuple(_row(c, stars) for c in document_cameras())


def _row(camera: DesignCamera, stars: StarTable) -> TradeRow:
    return camera_row(camera, stars, CAMERA_LOOKS, CAMERA_PAIRS)


class DesignService:
    """Evaluates designs; the rows of the documents' cameras are computed once."""

    def __init__(self, jobs: JobService, stars: StarTable) -> None:
        self._jobs, self._stars = jobs, stars
        self._rows: tuple[TradeRow, ...] = ()
        self.words: Callable[[Mapping[str, Any]], Question] | None = None
        """Parses a request as sent by the page; set by the API."""
        jobs.resumable("design", self._again)

    def document_rows(self) -> tuple[TradeRow, ...]:
        """Return the rows of the documents' cameras, as in their profiles."""
        self._rows = self._rows or document_rows(self._stars)
        return self._rows

    def quick(self, question: Question) -> dict[str, Any]:
        """Return the quick evaluation: fewer pointings and no lens trade."""
        return answer(question, self._stars, quick=True, documents=self.document_rows())

    def start(self, question: Question, asked: Mapping[str, Any]) -> Job:
        """Start the full evaluation as a job; its result is the record. An impossible camera is rejected at once."""
        request_of(question)

        return self._jobs.begin("design", f"design {question.profile}", dict(asked), self._work(question))

    def _again(self, run: Run) -> dict[str, Any]:
        if self.words is None:
            raise BadInput("nobody here reads the page's words", hint="ask again on the Design page")
        return self._work(self.words(run.request))(run)

    def _work(self, question: Question) -> Resumable:
        def work(run: Run) -> dict[str, Any]:
            return {"design": answer(question, self._stars, documents=self.document_rows(), progress=run.progress)}

        return work


def _by_percent(progress: Progress) -> Callable[[float], None]:
    """Report progress only when another percent is complete, because each report is a row in the store."""
    told = -1

    def tell(share: float) -> None:
        nonlocal told
        done = int(share * STEPS)
        if done > told:
            told = done
            progress(done, STEPS, "counting stars in fields")

    return tell


def radians(limits: tuple[float, float] | list[float]) -> Range:
    """Convert two values in degrees to radians."""
    return float(np.radians(limits[0])), float(np.radians(limits[1]))
