"""Creates an instrument package from photographs of the night sky, and tests the package on the same photographs."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import datetime

import numpy as np

from gss.domain.angles import ARCSEC_RAD
from gss.domain.words import counted
from gss.instruments.camera_text import camera_text, instrument_text
from gss.instruments.package import Instrument, load_instrument
from gss.instruments.package_files import InstrumentFile, Mounting
from gss.instruments.package_source import Files
from gss.operations.clock import Monotonic
from gss.operations.frames.observer import observer_at
from gss.operations.frames.solve import Solver
from gss.operations.studies.new_instrument_requests import PhotographOptions
from gss.operations.studies.night_frames import ProgressCallback, request_of
from gss.operations.studies.photograph_camera import PhotographCamera, measure
from gss.operations.studies.photograph_numbers import Stated, camera_file, model_reason
from gss.operations.studies.photographs import Photograph, PhotographRow, SortedPhotographs, sort_out, words_of

WORSE_TOGETHER = 2.0
"""Maximum ratio of the residual of all photographs fitted together to the residual of each photograph fitted alone. A
higher ratio indicates photographs of different cameras."""
MAX_NOTES = 3900


@dataclass(frozen=True)
class PackageTrial:
    """Result of solving one photograph with the new package. ``rms_arcsec``: residual per axis; ``seconds``: processing
    time."""

    name: str
    solved: bool
    reason: str
    matched: int
    rms_arcsec: float | None
    seconds: float


@dataclass(frozen=True)
class PhotographPackage:
    """A new instrument package. ``files``: files of the package; ``instrument``: instrument read from these files;
    ``rows``: a row for every photograph file; ``trials``: tests on the used photographs; ``warnings``: warnings of the
    calibration."""

    files: Files
    instrument: Instrument
    rows: tuple[PhotographRow, ...]
    trials: tuple[PackageTrial, ...]
    warnings: tuple[str, ...]

    @property
    def summary(self) -> str:
        """Summary of the result in one sentence."""
        camera = self.instrument.profile.camera
        solved = [t for t in self.trials if t.solved]
        rms = [t.rms_arcsec for t in solved if t.rms_arcsec is not None]
        width = math.degrees(camera.fov_rad[0])
        return (
            f"{words_of(self.rows)} used, field of view {width:.2f}°; {len(solved)} of {len(self.trials)} solved with the package, "
            f"residual {np.median(rms) if rms else math.nan:.1f}″"
        )


def make_package(
    solver: Solver,
    photographs: Sequence[Photograph],
    unreadable: Sequence[PhotographRow],
    options: PhotographOptions,
    model: Instrument | None,
    now: datetime,
    stopwatch_s: Monotonic,
    progress: ProgressCallback,
) -> PhotographPackage:
    """Return a tested package. Nothing is written to disk. ``model``: instrument from which everything except the
    camera is copied. Raises BadInput with a reason for each file if fewer than three photographs of one camera can be
    used."""
    timed = _with_exposure(_with_date(photographs, options.taken), options.exposure_s)
    limits = options.fov_limits_rad
    sorted_out = sort_out(solver, timed, unreadable, limits, lambda share, text: progress(0.6 * share, text))
    measured = measure(solver, sorted_out, lambda share, text: progress(0.6 + 0.3 * share, text))
    warnings = _warnings(measured)
    used = measured.photographs.used
    origin = f"photographs: {counted(len(used), 'frame')}, {_dates(measured.photographs, now)}"
    camera = camera_file(measured, _stated(measured.photographs, options), origin)
    instrument_file = _about(options, model, measured, origin, warnings)
    files = {
        "instrument.yaml": instrument_text(instrument_file),
        "camera.yaml": camera_text(camera, _comment(measured, warnings)),
    }
    if model is not None:
        copied = (
            "dictionary.yaml",
            "dictionary.xml",
            "operations.yaml",
            "link.yaml",
            "catalogue.yaml",
            "simulator.yaml",
        )
        files |= {name: data for name, data in model.files.items() if name in copied}
    instrument = load_instrument(files)
    trials = _trials(
        solver, measured.photographs, instrument, stopwatch_s, lambda s, text: progress(0.9 + 0.1 * s, text)
    )
    return PhotographPackage(files, instrument, measured.photographs.rows, trials, tuple(warnings))


def _with_date(photographs: Sequence[Photograph], taken: datetime | None) -> list[Photograph]:
    """Set the date stated by the user for photographs whose files do not state a date."""
    if taken is None:
        return list(photographs)
    observer = observer_at(taken)
    return [
        p
        if p.shot.observer is not None
        else replace(p, shot=replace(p.shot, taken=taken, observer=observer, time_known=True))
        for p in photographs
    ]


def _with_exposure(photographs: Sequence[Photograph], stated_s: float | None) -> list[Photograph]:
    """Set the exposure stated by the user for photographs without an exposure. If the user states no exposure and a
    photograph has none, remove the exposures of all photographs, because magnitudes cannot be compared then."""
    all_stated = all(p.shot.exposure_s for p in photographs)
    return [
        p
        if all_stated
        else replace(p, shot=replace(p.shot, exposure_s=(p.shot.exposure_s or stated_s) if stated_s else None))
        for p in photographs
    ]


def _stated(photographs: SortedPhotographs, options: PhotographOptions) -> Stated:
    """Return the properties that the user states, or otherwise the values that all files state."""

    def common_value(name: str) -> float | None:
        values = {s.photograph.file.get(name) for s in photographs.used}
        text = values.pop() if len(values) == 1 else None
        return float(text) if text else None

    return Stated(
        options.pixel_um or common_value("pixel_um"),
        options.focal_mm or common_value("focal_mm"),
        options.f_number or common_value("f_number"),
        options.atmosphere,
    )


def _dates(photographs: SortedPhotographs, now: datetime) -> str:
    shots = [s.photograph.shot for s in photographs.used]
    if any(shot.observer is None for shot in shots):
        return f"calibrated {now:%Y-%m-%d}"
    days = sorted({f"{shot.taken:%Y-%m-%d}" for shot in shots})
    return days[0] if len(days) == 1 else f"{days[0]} to {days[-1]}"


def _warnings(measured: PhotographCamera) -> list[str]:
    warnings = [f"{w.text}. {w.hint[:1].upper()}{w.hint[1:]}" for w in measured.geometry.warnings]
    single_rms_px = [row.rms_px for row in measured.photographs.rows if row.used and row.rms_px]
    joint_rms_px = measured.geometry.residuals.rms_px
    if single_rms_px and joint_rms_px > WORSE_TOGETHER * float(np.median(single_rms_px)):
        warnings.append(
            f"Residual of all photographs together {joint_rms_px:.2f} px, of each alone {np.median(single_rms_px):.2f} px. The "
            "photographs can be of different cameras, lenses or focus settings"
        )
    if measured.same_field:
        warnings.append(
            "All photographs show one field, so they count as one measurement and the optical centre is poorly determined. Point "
            "the camera to other parts of the sky"
        )
    resized = sorted(
        {s.photograph.file["original_px"] for s in measured.photographs.used if "original_px" in s.photograph.file}
    )
    if resized:
        warnings.append(
            f"Resized or cropped after the exposure (original {', '.join(resized)}). Use the original files"
        )
    if measured.light is not None:
        warnings += [f"{w.text}. {w.hint[:1].upper()}{w.hint[1:]}" for w in measured.light.warnings]
    return [*warnings, *(f"Not measured: {text}" for text in measured.missing)]


def _about(
    options: PhotographOptions,
    model: Instrument | None,
    measured: PhotographCamera,
    origin: str,
    warnings: Sequence[str],
) -> InstrumentFile:
    figures = measured.geometry.residuals
    notes = [
        f"The camera was calibrated from {origin.removeprefix('photographs: ')}; {words_of(measured.photographs.rows)} were used.",
        f"{figures.stars} stars, residual {figures.rms_px:.2f} px; {model_reason(measured)}.",
        *(f"{text}." for text in warnings),
    ]
    common = {
        "id": options.name,
        "title": options.title or f"Camera {options.name}, from photographs",
        "version": "1",
        "references": (origin,),
        "notes": "\n".join(notes)[:MAX_NOTES] + "\n",
    }
    if model is None:
        gss = {"driver": "gss", "dictionary": "gss-common", "mounting": Mounting(camera="zenith")}
        return InstrumentFile.model_validate(common | gss)
    return model.about.model_copy(update=common | {"maker": "", "tried_on_hardware": None})


def _comment(measured: PhotographCamera, warnings: Sequence[str]) -> list[str]:
    """Return the comment at the top of the camera file: all photographs, the lens models, and the warnings."""
    lines = [
        "Created by gss instrument new --from-frames. Every measured number has its standard deviation (sigma).",
        "",
        "Photographs:",
    ]
    for row in measured.photographs.rows:
        if row.used:
            lines.append(f"  {row.name}: {row.matched} stars, {row.rms_px or math.nan:.2f} px")
        else:
            lines.append(f"  {row.name}: not used: {row.reason}")
    lines += ["", "Lens models (parameters, BIC above the best, residual, residual of left-out photographs):"]
    for fit in measured.geometry.comparison:
        mark = ", chosen" if fit.chosen else ""
        lines.append(
            f"  {fit.model}: {fit.free_parameters}, {fit.bic:.1f}, {fit.rms_px:.3f} px, {fit.held_out_px:.3f} px{mark}"
        )
    if warnings:
        lines += ["", "Warnings:", *(f"  {text}" for text in warnings)]
    return [_printable(line) for line in lines]


def _printable(text: str) -> str:
    """Replace characters that a YAML file must not contain. File names can contain any character."""
    return "".join(c if c.isprintable() else "\N{REPLACEMENT CHARACTER}" for c in text)


def _trials(
    solver: Solver,
    photographs: SortedPhotographs,
    instrument: Instrument,
    stopwatch_s: Monotonic,
    progress: ProgressCallback,
) -> tuple[PackageTrial, ...]:
    """Solve the used photographs with the camera of the new instrument."""
    trials = []
    for k, solved_photograph in enumerate(photographs.used):
        progress(k / len(photographs.used), f"{solved_photograph.name} with the package")
        pixels = solved_photograph.photograph.shot.pixels()
        begin_s = stopwatch_s()
        result = solver.solve(
            pixels, request_of(solved_photograph.photograph.shot, instrument.profile, None, "reference")
        )
        seconds, solved = stopwatch_s() - begin_s, result.attitude is not None
        rms = result.residual_rms_px * instrument.profile.camera.pixel_rad / ARCSEC_RAD if solved else None
        matched = len(result.matches) if result.matches is not None else 0
        trials.append(PackageTrial(solved_photograph.name, solved, result.reason, matched, rms, seconds))
    return tuple(trials)
