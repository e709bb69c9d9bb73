"""Rows and records into what travels: the one place where radians become degrees and arcseconds."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from datetime import datetime
from typing import Any

import numpy as np

from gss.api.schemas.catalogues import (
    CatalogueDetailOut,
    CatalogueOut,
)
from gss.api.schemas.commands import (
    ArgumentOut,
    ByteGroupOut,
    CheckOut,
    ChoiceOut,
    CommandDefinitionOut,
    CommandOut,
    DictionaryOut,
    FieldDefinitionOut,
    PreconditionOut,
    StageOut,
)
from gss.api.schemas.events import ContactOut, EventOut
from gss.api.schemas.frames import (
    AttitudeOut,
    CameraOut,
    ComparisonOut,
    FrameDetailOut,
    FrameOut,
    PredictedOut,
    RegionOut,
    SolutionDetailOut,
    SolutionOut,
    StarOut,
)
from gss.api.schemas.jobs import JobOut
from gss.api.schemas.link import AlarmOut, BankOut, DirectionOut, LinkOut
from gss.api.schemas.telemetry import CycleOut, LatestOut, ValueOut
from gss.api.schemas.transfers import TransferOut
from gss.device.dictionary import Command as Definition
from gss.device.dictionary import Dictionary
from gss.domain.angles import wrap_pi_rad
from gss.domain.frames import pointing_difference_rad, ra_dec_roll_rad
from gss.domain.rotation import matrix_from_quaternion
from gss.operations.banks import BankView, days_left
from gss.operations.commanding import Check, PreconditionState
from gss.operations.frames import FrameDetail
from gss.operations.status import Header
from gss.operations.telemetry import FieldValue
from gss.operations.transfers import TransferView
from gss.store.models import Catalogue, Command, Contact, Device, Event, Frame, Job, Solution

STAGES = ("queued", "released", "sent", "accepted", "started", "progress", "completed")
ENDED = ("completed", "rejected", "failed", "unknown", "resolved")
AGREE_CROSS_ARCSEC = 120.0
AGREE_ROLL_ARCSEC = 360.0
TEXT_LENGTH = 120


def arcsec(angle_rad: float) -> float:
    """Radians to arcseconds."""
    return math.degrees(angle_rad) * 3600


# --- link -----------------------------------------------------------------------------------------------------------


def link(header: Header) -> LinkOut:
    """The header bar."""
    banks = [bank(view, header.utc) for view in header.banks]
    active = next((b for b in banks if b.active), None)
    values = {k: v for k, v in vars(header).items() if k not in ("tx", "rx", "banks", "alarms")}
    return LinkOut(
        **values,
        tx=DirectionOut.model_validate(header.tx),
        rx=DirectionOut.model_validate(header.rx),
        banks=banks,
        active_bank=active,
        alarms=[AlarmOut.model_validate(a) for a in header.alarms],
        role="operator",
        authority=header.user,
    )


def bank(view: BankView, now: datetime) -> BankOut:
    """One flash bank."""
    known = view.catalogue
    return BankOut(
        bank=view.bank,
        state=view.state,
        active=view.active,
        catalogue_id=known.id if known else None,
        catalogue_name=known.name if known else None,
        stars=view.stars,
        pairs=view.pairs,
        sha256=view.sha256,
        valid_to=known.valid_to if known else None,
        days_left=days_left(known.valid_to, now) if known else None,
    )


# --- commands and dictionary ----------------------------------------------------------------------------------------


def dictionary(d: Dictionary, preconditions: Mapping[str, Sequence[PreconditionState]]) -> DictionaryOut:
    """The whole dictionary with the present state of its preconditions."""
    fields = [
        FieldDefinitionOut(
            name=f.name,
            packet=packet.name,
            page=f.page,
            title=f.title,
            unit=f.unit,
            decimals=f.decimals,
            watch=f.limits.watch,
            warning=f.limits.warning,
            critical=f.limits.critical,
            stale_after_s=f.stale_after_s,
        )
        for packet in d.telemetry
        for f in packet.values
    ]
    commands = [definition(c, preconditions.get(c.name, ())) for c in d.commands]
    return DictionaryOut(hash=d.hash_hex, commands=commands, telemetry=fields)


def definition(c: Definition, states: Sequence[PreconditionState]) -> CommandDefinitionOut:
    """One command of the dictionary."""
    arguments = [
        ArgumentOut(
            name=a.name,
            type=a.type,
            unit=a.unit,
            purpose=a.purpose,
            min=a.minimum,
            max=a.maximum,
            default=None if isinstance(a.default, bytes) else a.default,
            choices=[ChoiceOut(name=x.name, value=x.value, hazard=str(x.hazard), note=x.note) for x in a.choices],
        )
        for a in c.arguments
    ]
    return CommandDefinitionOut(
        name=c.name,
        code=c.code,
        subsystem=c.subsystem,
        purpose=c.purpose,
        hazard=c.hazard.value,
        hazard_reason=c.hazard_reason,
        idempotent=c.idempotent,
        role=c.role,
        favourite=c.favourite,
        arguments=arguments,
        preconditions=[precondition(s) for s in states],
        accept_within_s=c.accept_s,
        complete_within_s=c.complete_s,
    )


def precondition(state: PreconditionState) -> PreconditionOut:
    """One condition."""
    return PreconditionOut(text=state.text, met=state.met, value=state.value)


def check(result: Check, argument_names: Sequence[str]) -> CheckOut:
    """A dry run."""
    groups = [
        ByteGroupOut(label=label, hex=data.hex(" "), argument=label in argument_names) for label, data in result.groups
    ]
    size = sum(len(data) for _, data in result.groups)
    return CheckOut(
        problems=list(result.problems),
        preconditions=[precondition(s) for s in result.preconditions],
        bytes=groups,
        size=size,
    )


def command(row: Command) -> CommandOut:
    """A command with its stage lights."""
    duration_s = (row.finished - row.created).total_seconds() if row.finished else None
    return CommandOut(
        id=row.id,
        request_id=row.request_id,
        name=row.name,
        arguments=row.arguments,
        text=_arguments_text(row.arguments),
        user=row.user,
        source=row.source,
        created=row.created,
        finished=row.finished,
        duration_s=duration_s,
        stages=_stages(row),
        result=row.result,
        detail=row.detail,
        late=row.late,
        attempts=row.attempts,
        resolved_note=row.resolved_note,
        values=row.values,
    )


def _arguments_text(arguments: Mapping[str, Any]) -> str:
    text = ", ".join(f"{name.rsplit('_', 1)[0] if '_' in name else name} {value}" for name, value in arguments.items())
    return text if len(text) <= TEXT_LENGTH else text[: TEXT_LENGTH - 1] + "…"


def _stages(row: Command) -> list[StageOut]:
    """Seven lights: what was passed, where it stands or ended, and what is still to come."""
    at = {stage.stage: stage.at for stage in row.stages}
    reached = max((STAGES.index(name) for name in at if name in STAGES), default=0)
    lights = []
    for k, name in enumerate(STAGES):
        state = "to_come"
        if k <= reached:
            state = "passed" if name in at else "skipped"
        if k == reached and row.result not in ENDED:
            state = "now"
        if k == reached + 1 and row.result in ("rejected", "failed"):
            state = "failed"
        if k == reached + 1 and row.result in ("unknown", "resolved"):
            state = "unknown"
        lights.append(StageOut(name=name, state=state, at=at.get(name)))  # type: ignore[arg-type]  # literals by construction
    return lights


# --- telemetry ------------------------------------------------------------------------------------------------------


def latest(values: Sequence[FieldValue]) -> LatestOut:
    """All fields with their states."""
    return LatestOut(values=[value(v) for v in values])


def value(v: FieldValue) -> ValueOut:
    """One field."""
    shown = v.value.hex() if isinstance(v.value, bytes) else v.value
    raw = v.raw if isinstance(v.raw, int | float) else None
    text = v.state if v.state != "stale" or v.age_s is None else f"stale {v.age_s:.0f} s"
    return ValueOut(
        name=v.definition.name,
        packet=v.packet,
        title=v.definition.title,
        page=v.definition.page,
        raw=_finite(raw),
        value=_finite(shown) if isinstance(shown, float) else shown,
        formatted=_formatted(shown, v.definition.decimals),
        unit=v.definition.unit,
        state=v.state,  # type: ignore[arg-type]  # the service's words are the schema's
        text=text,
        at=v.at,
        age_s=v.age_s,
    )


def _formatted(shown: Any, decimals: int) -> str:
    if shown is None:
        return "–"
    if isinstance(shown, bool):
        return "yes" if shown else "no"
    if isinstance(shown, float | int):
        text = f"{shown:.{decimals}f}" if isinstance(shown, float) else str(shown)
        return text.replace("-", "−")
    return str(shown)


def _finite(x: float | None) -> float | None:
    return x if x is not None and math.isfinite(x) else None


def cycle(timed: tuple[datetime, Mapping[str, Any]]) -> CycleOut:
    """Timing of one iteration."""
    at, values = timed
    stages = {
        f"{name}_ms": float(values[f"{name}_ms"]) for name in ("capture", "transfer", "detect", "match", "attitude")
    }
    # The next image is taken while this one is worked on (Erlank 2013 §5.3.4, Fig. 5.8); only its transfer stops both.
    working_ms = stages["detect_ms"] + stages["match_ms"] + stages["attitude_ms"]
    total_ms = max(stages["capture_ms"], working_ms) + stages["transfer_ms"]
    return CycleOut(iteration=int(values["iteration"]), at=at, total_ms=total_ms, **stages)


# --- frames ---------------------------------------------------------------------------------------------------------


def attitude(quaternion: Sequence[float] | None, sigma_rad: Sequence[float | None] | None) -> AttitudeOut | None:
    """Degrees, quaternion, arcseconds."""
    if quaternion is None:
        return None
    ra, dec, roll = ra_dec_roll_rad(matrix_from_quaternion(np.array(quaternion, float)))
    cross, about = sigma_rad or (None, None)
    x, y, z, w = (float(q) for q in quaternion)
    return AttitudeOut(
        ra_deg=math.degrees(ra),
        dec_deg=math.degrees(dec),
        roll_deg=math.degrees(roll),
        quaternion=(x, y, z, w),
        sigma_cross_arcsec=None if cross is None else arcsec(cross),
        sigma_roll_arcsec=None if about is None else arcsec(about),
    )


def frame(row: Frame, best: Solution | None) -> FrameOut:
    """A frame with the essence of its newest ground solution."""
    return FrameOut(**_frame_values(row, best))


def _frame_values(row: Frame, best: Solution | None) -> dict[str, Any]:
    names = (
        "id number slot source name taken received columns rows bits "
        "exposure_s profile mode sha256 complete rows_held contact_id"
    )
    values = {name: getattr(row, name) for name in names.split()}
    return values | {
        "verdict": best.verdict if best else None,
        "outcome": best.outcome if best else None,
        "chain": best.chain if best else None,
        "matched": best.matched if best else None,
        "centroids": best.found if best else None,
        "attitude": attitude(best.quaternion, best.sigma_rad) if best else None,
    }


def frame_detail(detail: FrameDetail) -> FrameDetailOut:
    """A frame with everything that was made of it."""
    return FrameDetailOut(
        **_frame_values(detail.frame, detail.ground),
        solutions=[solution(s) for s in detail.solutions],
        on_board=solution_detail(detail.on_board) if detail.on_board else None,
        ground=solution_detail(detail.ground) if detail.ground else None,
        comparison=comparison(detail.on_board, detail.ground),
        truth=attitude(detail.frame.truth, None),
    )


def solution(row: Solution) -> SolutionOut:
    """A result without its overlays."""
    return SolutionOut(**_solution_values(row))


def _solution_values(row: Solution) -> dict[str, Any]:
    names = (
        "id frame_id origin chain version created outcome reason found matched rejected rms_px "
        "false_match_probability verdict replay notes"
    )
    values = {name: getattr(row, name) for name in names.split()}
    fov_deg = tuple(math.degrees(v) for v in row.fov_rad) if row.fov_rad else None
    deltas = [
        s["dx_arcsec"] ** 2 + s["dy_arcsec"] ** 2
        for s in row.detail["stars"]
        if s.get("dx_arcsec") is not None and s["weight"] > 0
    ]
    return values | {
        "attitude": attitude(row.quaternion, row.sigma_rad),
        "rms_arcsec": math.sqrt(sum(deltas) / (2 * len(deltas))) if deltas else None,
        "fov_deg": fov_deg,
        "timing_ms": {name: 1000 * s for name, s in row.timing_s.items()},
        "error_axis_arcsec": None if row.error_axis_rad is None else arcsec(row.error_axis_rad),
        "error_roll_arcsec": None if row.error_roll_rad is None else arcsec(row.error_roll_rad),
    }


def solution_detail(row: Solution) -> SolutionDetailOut:
    """A result with its overlays."""
    detail = row.detail
    optional = ("hip", "name", "v_mag", "dx_px", "dy_px", "dx_arcsec", "dy_arcsec", "weight")
    return SolutionDetailOut(
        **_solution_values(row),
        regions=[RegionOut(**r) for r in detail["regions"]],
        stars=[StarOut(**(dict.fromkeys(optional) | s)) for s in detail["stars"]],
        predicted=[PredictedOut(**p) for p in detail["predicted"]],
        camera=CameraOut(**row.camera),
        grid=detail["grid"],
        north=detail["north"],
        field=[(math.degrees(a), math.degrees(d)) for a, d in detail["field"]],
    )


def comparison(on_board: Solution | None, ground: Solution | None) -> ComparisonOut | None:
    """On board minus ground."""
    if on_board is None or ground is None or on_board.quaternion is None or ground.quaternion is None:
        return None
    a, b = (matrix_from_quaternion(np.array(s.quaternion, float)) for s in (on_board, ground))
    (ra_a, dec_a, roll_a), (ra_b, dec_b, roll_b) = ra_dec_roll_rad(a), ra_dec_roll_rad(b)
    cross, about = (arcsec(x) for x in pointing_difference_rad(a, b))
    agree = cross < AGREE_CROSS_ARCSEC and abs(about) < AGREE_ROLL_ARCSEC
    return ComparisonOut(
        d_ra_arcsec=arcsec(float(wrap_pi_rad(ra_a - ra_b))),
        d_dec_arcsec=arcsec(dec_a - dec_b),
        d_roll_arcsec=arcsec(float(wrap_pi_rad(roll_a - roll_b))),
        cross_arcsec=cross,
        agree=agree,
        text="on board and ground agree"
        if agree
        else f"on board and ground differ by {cross:.0f}″ across, {about:.0f}″ about",
    )


# --- catalogues -----------------------------------------------------------------------------------------------------


def catalogue(row: Catalogue, banks: Sequence[BankView]) -> CatalogueOut:
    """A built catalogue."""
    return CatalogueOut(**_catalogue_values(row, banks))


def _catalogue_values(row: Catalogue, banks: Sequence[BankView]) -> dict[str, Any]:
    names = "id name profile format created author stars pairs sha256 valid_from valid_to"
    values = {name: getattr(row, name) for name in names.split()}
    return values | {"bytes": row.size, "banks": [b.bank for b in banks if b.sha256 == row.sha256]}


def catalogue_detail(row: Catalogue, banks: Sequence[BankView]) -> CatalogueDetailOut:
    """A built catalogue with map and quality; one that was read back has neither."""
    return CatalogueDetailOut(
        **_catalogue_values(row, banks),
        request=row.request,
        manifest=row.manifest,
        funnel=row.report.get("funnel", []),
        sky=row.report.get("sky", []),
        envelope=row.report.get("envelope"),
        quality=row.report.get("quality"),
    )


# --- transfers, jobs, events ----------------------------------------------------------------------------------------


def transfer(view: TransferView) -> TransferOut:
    """A transfer with the figures of the moment."""
    row, live = view.row, view.live
    chunks = -(-row.size // row.chunk_size) if row.chunk_size else 0
    stored = [(int(a), int(b)) for a, b in row.stored]
    stored_bytes = min(row.size, sum(b - a + 1 for a, b in stored) * row.chunk_size)
    names = "id direction kind target subject state reason size chunk_size resent sha256 created finished frame_id catalogue_id log"
    return TransferOut(
        **{name: getattr(row, name) for name in names.split()},
        chunks=chunks,
        stored=stored,
        stored_bytes=stored_bytes,
        rate_bytes_s=live.rate_bytes_s if live else None,
        line_share=live.line_share if live else None,
        left_s=live.left_s if live else None,
    )


def job(row: Job) -> JobOut:
    """A job."""
    return JobOut.model_validate(row)


def event(row: Event) -> EventOut:
    """One line of the record."""
    return EventOut.model_validate(row)


def contact(row: Contact, device: Device | None, frames: int, commands: int) -> ContactOut:
    """A contact."""
    return ContactOut(
        id=row.id,
        device=device.name if device else "nobody answered",
        url=row.url,
        started=row.started,
        ended=row.ended,
        rx_bytes=row.rx_bytes,
        tx_bytes=row.tx_bytes,
        frames=frames,
        commands=commands,
    )
