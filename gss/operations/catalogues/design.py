"""Camera design: evaluates a camera that a user edited on the page or in the terminal. The quick evaluation answers a
request. The full evaluation is a job."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, fields, replace
from typing import Annotated, Literal

from pydantic import Field

from gss.catalogue_tools.design.camera import DesignCamera
from gss.catalogue_tools.design.design_report import EXCLUSION_RAD, FULL, QUICK, DesignRequest, camera_row, design
from gss.catalogue_tools.design.trade import TradeRow
from gss.catalogue_tools.envelope.attitude import ORBIT_LAWS, AttitudeLimits
from gss.catalogue_tools.envelope.envelope import BandEnvelope, Envelope
from gss.catalogue_tools.envelope.orbits import Range, from_elements
from gss.domain.callbacks import no_progress
from gss.domain.camera_profile import CameraProfile
from gss.domain.errors import BadInput
from gss.domain.stars import StarTable
from gss.instruments.registry import Registry
from gss.operations.catalogues.design_record import record_of
from gss.operations.catalogues.design_values import DesignValues
from gss.operations.job_rules import nested_request
from gss.operations.jobs import JobKind, JobRequest, JobResult, JobRun, JobService, Progress
from gss.operations.requests import Request
from gss.store.models import Job

STEPS = 100
WORKERS = 2
CAMERA_LOOKS, CAMERA_PAIRS = 1500, 3e4
EDITABLE = tuple(f.name for f in fields(DesignCamera) if f.name != "name")
"""Names of the camera values that a design can change."""
Number = Annotated[float | None, Field(allow_inf_nan=False)]
Two = Annotated[list[float], Field(min_length=2, max_length=2)]
"""Minimum and maximum, degrees."""


class DesignQuestion(Request):
    """Documented camera and changes to it; null: value of the profile. ``mag_limit``: null: derived from the radiometry.
    ``sky``: whole sky, or along an orbit with a pointing law and its limits in degrees. ``pointings``: number of
    pointings in the full evaluation."""

    profile: str = Field(default="", max_length=40, description="Instrument; empty: that of the unit on the line.")
    columns: int | None = None
    rows: int | None = None
    pitch_col_um: Number = None
    pitch_row_um: Number = None
    focal_mm: Number = None
    f_number: Number = None
    transmission: Number = None
    efficiency: Number = None
    bandwidth_nm: Number = None
    exposure_s: Number = None
    psf_sigma_px: Number = None
    bits: int | None = None
    gain_e_per_dn: Number = None
    bias_dn: Number = None
    full_well_e: Number = None
    read_noise_e: Number = None
    dark_current_e_s: Number = None
    background_e_s: Number = None
    response_sigma: Number = None
    threshold_snr: Number = None
    mag_limit: Number = None
    exclusion_deg: Number = None
    spare_mm: float = Field(default=0.0, ge=0, le=1000)
    sky: Literal["whole", "orbit"] = "whole"
    inclination_deg: float = Field(default=97.6, ge=0, le=180)
    raan_deg: Two = Field(default=[0.0, 360.0])
    pointing: str = Field(default="zenith", max_length=20)
    roll_deg: Two = Field(default=[-5.0, 5.0])
    pitch_deg: Two = Field(default=[-5.0, 5.0])
    yaw_deg: Two = Field(default=[-5.0, 5.0])
    seed: int = Field(default=1, ge=0, le=2**31 - 1)
    pointings: int = Field(default=1_000_000, ge=1_000, le=10_000_000)

    @property
    def changes(self) -> dict[str, float]:
        """Camera values in the request, which replace values of the profile."""
        values = self.model_dump(include=set(EDITABLE), exclude_none=True)
        return {name: values[name] for name in EDITABLE if name in values}


@dataclass(frozen=True)
class DesignJob(JobRequest):
    """Job that evaluates a design in full."""

    asked: DesignQuestion


def request_of(question: DesignQuestion, base: DesignCamera) -> DesignRequest:
    """Return the design request: the camera ``base`` with the changes, and its pointing envelope in radians. Raises BadInput if
    they are not valid."""
    camera = base.edited(**question.changes)
    exclusion_rad = EXCLUSION_RAD if question.exclusion_deg is None else math.radians(question.exclusion_deg)
    return DesignRequest(camera, _envelope(camera, question), exclusion_rad, question.spare_mm, question.seed)


def _envelope(camera: DesignCamera, question: DesignQuestion) -> Envelope | None:
    if question.sky == "whole":
        return None
    if question.pointing not in ORBIT_LAWS:
        raise BadInput(
            "this pointing law does not follow an orbit", expected=" | ".join(ORBIT_LAWS), got=question.pointing
        )
    roll, pitch, yaw = radians(question.roll_deg), radians(question.pitch_deg), radians(question.yaw_deg)
    limits = AttitudeLimits(question.pointing, roll, pitch, yaw)
    inclination_rad = math.radians(question.inclination_deg)
    orbits = from_elements((inclination_rad, inclination_rad), radians(question.raan_deg))
    return BandEnvelope(camera.shape, limits, orbits)


def answer(
    question: DesignQuestion,
    base: DesignCamera,
    stars: StarTable,
    *,
    quick: bool = False,
    documents: tuple[TradeRow, ...],
    progress: Progress = no_progress,
) -> DesignValues:
    """Evaluate a design and return its record. ``quick``: fewer pointings and no lens trade. ``documents``: rows of the
    documented cameras, for comparison."""
    start_s = time.perf_counter()
    request = request_of(question, base)
    if quick:
        report = design(request, stars, QUICK)
    else:
        effort = replace(FULL, pointings=question.pointings, looks=min(FULL.looks, question.pointings))
        pool = ThreadPoolExecutor(WORKERS, thread_name_prefix="design")
        try:
            report = design(request, stars, effort, each=pool.map, progress=_by_percent(progress))
        finally:
            # A cancelled job must not start the queued work.
            pool.shutdown(wait=True, cancel_futures=True)
    own_row = () if request.camera in [r.camera for r in documents] else (_row(request.camera, stars),)
    return record_of(report, base, (*own_row, *documents), 1000 * (time.perf_counter() - start_s))


def document_rows(cameras: Iterable[CameraProfile], stars: StarTable) -> tuple[TradeRow, ...]:
    """Return the comparison rows of documented cameras."""
    return tuple(_row(DesignCamera.from_profile(c), stars) for c in cameras)


def _row(camera: DesignCamera, stars: StarTable) -> TradeRow:
    return camera_row(camera, stars, CAMERA_LOOKS, CAMERA_PAIRS)


class DesignService:
    """Evaluates designs. The comparison rows of the documented cameras are cached until a documented camera changes."""

    def __init__(self, jobs: JobService, stars: StarTable, instruments: Registry, unit: str) -> None:
        self._jobs, self.stars, self._instruments, self._unit = jobs, stars, instruments, unit
        self._rows: tuple[dict[str, CameraProfile], tuple[TradeRow, ...]] = {}, ()
        jobs.register(JobKind("design", DesignJob, self._evaluate, older=nested_request))

    def document_rows(self) -> tuple[TradeRow, ...]:
        """Return the comparison rows of the documented cameras."""
        cameras = self._instruments.cameras()
        last = self._rows  # read once, because another thread can replace it
        if last[0] != cameras:
            self._rows = last = cameras, document_rows(cameras.values(), self.stars)
        return last[1]

    def quick(self, question: DesignQuestion) -> DesignValues:
        """Return the quick evaluation: fewer pointings and no lens trade."""
        return answer(question, self.base(question), self.stars, quick=True, documents=self.document_rows())

    def start(self, question: DesignQuestion, *, user: str) -> Job:
        """Start the full evaluation as a job. The result of the job is the record. An invalid camera is rejected immediately."""
        base = self.base(question)
        request_of(question, base)
        return self._jobs.begin("design", f"design {base.name}", DesignJob(question, user=user))

    def _evaluate(self, job: DesignJob, run: JobRun) -> JobResult:
        base, rows = self.base(job.asked), self.document_rows()
        return {"design": answer(job.asked, base, self.stars, documents=rows, progress=run.progress)}

    def base(self, question: DesignQuestion) -> DesignCamera:
        """Return the documented camera of a question. Raises NotFound."""
        return DesignCamera.from_profile(self._instruments.camera(question.profile or self._unit))


def _by_percent(progress: Progress) -> Callable[[float], None]:
    """Return a progress callback that reports only when another percent is complete, because each report is stored."""
    reported = -1

    def report_progress(share: float) -> None:
        nonlocal reported
        done = int(share * STEPS)
        if done > reported:
            reported = done
            progress(done, STEPS, "Counting stars in fields")

    return report_progress


def radians(limits: Sequence[float]) -> Range:
    """Convert a range from degrees to radians."""
    return math.radians(limits[0]), math.radians(limits[1])
