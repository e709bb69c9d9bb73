"""Self-calibration, the default calibration method: one camera and all attitudes are fitted to the matched stars of
many frames.

Lens models are compared by the Bayesian information criterion on the same stars. Parameters that the data do not
determine are fixed and listed. The result is cross-validated on held-out frames. The method is based on Jacobs 1995
§6.2 and on Pal, Bhat 2014, who calibrate a camera from stars. Jacobs solves one group of parameters after the other;
here all parameters are fitted together.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gss.domain.angles import Array
from gss.domain.camera import Camera, RadialTilt
from gss.domain.errors import BadInput
from gss.domain.experiment import Progress
from gss.domain.rotation import quaternion_from_matrix
from gss.domain.words import counted
from gss.pipeline.calibration.advice import Advice
from gss.pipeline.calibration.bundle import Adjusted, Prior, huber_cost
from gss.pipeline.calibration.hold_out import held_out
from gss.pipeline.calibration.lens_models import GEOMETRY, LENS_MODELS, UNITS, vector_of
from gss.pipeline.calibration.residual_figures import ResidualFigures, residual_figures, residual_map
from gss.pipeline.calibration.result import CameraCalibration, FrameFit, Frozen, ModelFit, Parameter, StarResiduals
from gss.pipeline.calibration.screening import ScreenedFrames, poor_data, screen
from gss.pipeline.calibration.sightings import FrameStars
from gss.pipeline.calibration.star_stack import StarStack, attitudes_of, stack
from gss.pipeline.calibration.support import hold_unsupported

MODELS = tuple(LENS_MODELS)
MISFIT_RATIO = 4.0  # a frame that fits worse than the median by this factor is from another camera or has false matches
PLATE_SCALE = 0.01
WORSE = 1.05


@dataclass(frozen=True)
class _Trial:
    fit: Adjusted
    frozen: tuple[Frozen, ...]


def _quiet(_: float) -> None:
    pass


def calibrate_camera(
    frames: Sequence[FrameStars],
    start: Camera,
    *,
    models: Sequence[str] = MODELS,
    focal_mm: float | None = None,
    priors: Mapping[str, Prior] | None = None,
    folds: int = 5,
    progress: Progress = _quiet,
) -> CameraCalibration:
    """Calibrate from frames with matched stars. ``start``: the camera before calibration. ``models``: lens models to
    compare; a single model is used without comparison. "radial-tilt" has a polynomial in millimetres. It is compared
    only if ``focal_mm`` is given or ``start`` already has this model. ``priors``: bench measurements, by parameter
    name. Raises BadInput if a model or prior is not valid, no frame is suitable, or there are not more equations than
    unknowns.
    """
    prior_values = dict(priors or {})
    chosen_models = _models(models, start, focal_mm)
    _known_names(prior_values, chosen_models)
    screened = screen(frames, start)
    _enough(screened, len(frames))
    stars = stack(screened.frames)
    scale_mm = focal_mm if focal_mm is not None else float("nan")
    trials = _fit_all(stars, start, chosen_models, scale_mm, prior_values, progress)
    screened, stars, changed = _without_misfits(screened, stars, trials)
    if changed:
        trials = _fit_all(stars, start, chosen_models, scale_mm, prior_values, progress)
    comparison, outside = _compare(stars, trials, prior_values, folds, progress)
    best = next(row.model for row in comparison if row.chosen)
    return _result(screened, stars, start, trials[best], best, comparison, outside[best])


def _models(models: Sequence[str], start: Camera, focal_mm: float | None) -> tuple[str, ...]:
    unknown = [m for m in models if m not in LENS_MODELS]
    if unknown or not models:
        raise BadInput("unknown lens model", expected=" | ".join(LENS_MODELS), got=", ".join(unknown) or "none")
    scaled = focal_mm is not None or isinstance(start.distortion, RadialTilt)
    if not scaled and tuple(models) == ("radial-tilt",):
        raise BadInput(
            "a polynomial in millimetres needs a focal length in millimetres", expected="focal_mm", got="none"
        )
    return tuple(m for m in models if scaled or m != "radial-tilt")


def _known_names(priors: Mapping[str, Prior], models: Sequence[str]) -> None:
    names = {*GEOMETRY, *(n for m in models for n in LENS_MODELS[m])}
    wrong = [n for n, p in priors.items() if n not in names or not p.sigma > 0]
    if wrong:
        raise BadInput(
            "invalid prior values",
            expected=f"for each of {', '.join(sorted(names))}: a value, and a σ above zero",
            got=", ".join(wrong),
        )


def _enough(screened: ScreenedFrames, frame_count: int) -> None:
    stars = sum(map(len, screened.frames))
    unknowns = 3 * len(screened.frames) + 4
    if screened.frames and 2 * stars > unknowns:
        return
    why = "; ".join(f"{name}: {reason}" for name, reason in screened.excluded[:4])
    hint = screened.warnings[0].hint if screened.warnings else "longer exposures, or a denser part of the sky"
    raise BadInput(
        "these frames are not sufficient for a calibration",
        expected=f"more than {max(unknowns, 10) // 2} stars matched",
        got=f"{stars} in {len(screened.frames)} of {counted(frame_count, 'frame')}" + (f" ({why})" if why else ""),
        hint=hint,
    )


def _fit_all(
    stars: StarStack,
    start: Camera,
    models: tuple[str, ...],
    focal_mm: float,
    priors: Mapping[str, Prior],
    progress: Progress,
) -> dict[str, _Trial]:
    turns = attitudes_of(stars, start)
    trials: dict[str, _Trial] = {}
    for k, model in enumerate(models):
        vector = vector_of(start, model, focal_mm)
        fit, frozen = hold_unsupported(stars, vector, turns, priors)
        trials[model] = _Trial(fit, frozen)
        progress(0.5 * (k + 1) / len(models))
    return trials


def _without_misfits(
    screened: ScreenedFrames, stars: StarStack, trials: Mapping[str, _Trial]
) -> tuple[ScreenedFrames, StarStack, bool]:
    """Exclude frames that the best model fits far worse than the median frame. Such a frame is from another camera, or
    its stars were misidentified. If more than 30 % of the frames are affected, none is excluded."""
    fit = min(trials.values(), key=lambda t: t.fit.scale).fit
    length = np.hypot(fit.residual_px[:, 0], fit.residual_px[:, 1]) / stars.sigma_px
    typical = np.array([float(np.median(length[stars.frame == f])) for f in range(stars.frames)])
    misfits = typical > MISFIT_RATIO * max(float(np.median(typical)), 1e-9)
    if not misfits.any() or misfits.mean() > 0.3:
        return screened, stars, False
    names = [(f.name, "does not fit the others") for f, s in zip(screened.frames, misfits, strict=True) if s]
    text = f"{counted(len(names), 'frame')} excluded: they do not fit the others"
    hint = "check that they are from the same camera and focus, and that their stars are identified correctly"
    remaining = tuple(f for f, s in zip(screened.frames, misfits, strict=True) if not s)
    better = ScreenedFrames(
        remaining,
        screened.scale[~misfits],
        (*screened.excluded, *names),
        (*screened.warnings, Advice("mixed-cameras", text, hint)),
    )
    return better, stars.of_frames(~misfits), True


def _compare(
    stars: StarStack, trials: Mapping[str, _Trial], priors: Mapping[str, Prior], folds: int, progress: Progress
) -> tuple[tuple[ModelFit, ...], dict[str, ResidualFigures | None]]:
    """Compare the models by information criteria and by cross-validation. The criteria are computed on the stars that
    the best-fitting model kept. They contain the logarithm of the misfit, because the size of the star errors is
    unknown too. A small improvement is therefore significant only with many stars."""
    best_fit = min(trials.values(), key=lambda t: t.fit.scale).fit
    best_used = best_fit.used
    scaled = stars.sigma_px[best_used] * best_fit.scale
    equations = max(2 * int(best_used.sum()) - 3 * stars.frames, 2)
    bic: dict[str, float] = {}
    aicc: dict[str, float] = {}
    outside: dict[str, ResidualFigures | None] = {}
    for k, (model, trial) in enumerate(trials.items()):
        r = trial.fit.residual_px[best_used]
        misfit = equations * float(np.log(max(huber_cost(np.hypot(r[:, 0], r[:, 1]) / scaled), 1e-12) / equations))
        free = len(trial.fit.vector.free)
        bic[model] = misfit + free * float(np.log(equations))
        aicc[model] = misfit + 2 * free + 2 * free * (free + 1) / max(equations - free - 1, 1)
        outside[model] = held_out(stars, trial.fit, priors, folds)
        progress(0.5 + 0.5 * (k + 1) / len(trials))
    best = min(bic, key=lambda m: (bic[m], len(trials[m].fit.vector.free)))
    rows = [
        ModelFit(
            model,
            len(t.fit.vector.free),
            bic[model] - bic[best],
            aicc[model] - min(aicc.values()),
            residual_figures(t.fit.residual_px, stars.sigma_px, best_used).rms_px,
            _rms(outside[model]),
            model == best,
            tuple(f.name for f in t.frozen),
        )
        for model, t in trials.items()
    ]
    return tuple(rows), outside


def _rms(figures: ResidualFigures | None) -> float:
    return float("nan") if figures is None else figures.rms_px


def _result(
    screened: ScreenedFrames,
    stars: StarStack,
    start: Camera,
    trial: _Trial,
    model: str,
    comparison: tuple[ModelFit, ...],
    outside: ResidualFigures | None,
) -> CameraCalibration:
    fit = trial.fit
    size = (start.columns, start.rows)
    turns = attitudes_of(stars, start)
    before = stars.pixels - start.project(np.einsum("nij,nj->ni", turns[stars.frame], stars.icrs))
    clean = fit.used & np.isfinite(before).all(axis=1)
    parameters, covariance = _parameters(fit)
    after_figures = residual_figures(fit.residual_px, stars.sigma_px, fit.used, fit.freedom)
    before_figures = residual_figures(before, stars.sigma_px, clean)
    warnings = [*screened.warnings, *poor_data(stars.pixels[fit.used], stars.frames, size), *_advice(fit, trial, start)]
    if after_figures.rms_px > WORSE * before_figures.rms_px:
        text = f"the residuals increased from {before_figures.rms_px:.2f} px to {after_figures.rms_px:.2f} px"
        warnings.append(
            Advice(
                "worse",
                text,
                "keep the present camera; take frames over the whole sky, or use another lens model",
                True,
            )
        )
    return CameraCalibration(
        fit.camera,
        model,
        start,
        parameters,
        covariance,
        trial.frozen,
        after_figures,
        before_figures,
        outside,
        comparison,
        _frames(screened, stars, fit),
        residual_map(stars.pixels[clean], before[clean], size),
        residual_map(stars.pixels[fit.used], fit.residual_px[fit.used], size),
        _stars(screened, stars, fit, before),
        tuple(warnings),
    )


def _parameters(fit: Adjusted) -> tuple[tuple[Parameter, ...], Array]:
    factor = np.array([fit.vector.values[n] if n in ("focal_px", "aspect") else 1.0 for n in fit.vector.free])
    covariance = fit.covariance * np.outer(factor, factor)
    sigma = np.sqrt(np.maximum(np.diag(covariance), 0))
    values = fit.vector.values
    parameters = [
        Parameter(n, values[n], float(s), UNITS.get(n, "")) for n, s in zip(fit.vector.free, sigma, strict=True)
    ]
    return tuple(parameters), covariance


def _advice(fit: Adjusted, trial: _Trial, start: Camera) -> list[Advice]:
    advice: list[Advice] = []
    start_focal_px = vector_of(start, fit.vector.model, 1.0).values["focal_px"]
    ratio = fit.vector.values["focal_px"] / start_focal_px
    if abs(ratio - 1) > PLATE_SCALE:
        text = f"the focal length is {ratio:.4f} times the value in the profile ({start_focal_px:.1f} px)"
        advice.append(
            Advice(
                "plate-scale",
                text,
                "check the profile, the binning and the pixel pitch; if they are right, use the calibrated value",
            )
        )
    if trial.frozen:
        names = ", ".join(f.name for f in trial.frozen)
        advice.append(
            Advice(
                "unsupported",
                f"the stars do not determine {names}; kept at the start value",
                "use more frames, and stars in a larger part of the field",
            )
        )
    rejected = float(np.mean(~fit.used))
    if rejected > 0.1:
        advice.append(
            Advice("rejected", f"{rejected:.0%} of the stars do not fit", "check for false matches or double stars")
        )
    return advice


def _frames(screened: ScreenedFrames, stars: StarStack, fit: Adjusted) -> tuple[FrameFit, ...]:
    rows = []
    for k, frame in enumerate(screened.frames):
        in_frame = stars.frame == k
        used_stars: NDArray[np.bool_] = in_frame & fit.used
        rms = float(np.sqrt(np.mean(fit.residual_px[used_stars] ** 2))) if used_stars.any() else float("nan")
        quaternion = quaternion_from_matrix(fit.cam_from_icrs[k])
        covariance = fit.attitude_covariance_rad2[k]
        rejected = int(in_frame.sum()) - int(used_stars.sum())
        rows.append(
            FrameFit(
                frame.name,
                frame.time_s,
                int(in_frame.sum()),
                rejected,
                rms,
                quaternion,
                covariance,
                float(screened.scale[k]),
            )
        )
    excluded_fit = FrameFit(
        "", float("nan"), 0, 0, float("nan"), np.full(4, np.nan), np.full((3, 3), np.nan), float("nan")
    )
    rows += [replace(excluded_fit, name=name, excluded=reason) for name, reason in screened.excluded]
    return tuple(rows)


def _stars(screened: ScreenedFrames, stars: StarStack, fit: Adjusted, before: Array) -> StarResiduals:
    return StarResiduals(
        stars.frame,
        np.concatenate([f.hip for f in screened.frames]),
        np.concatenate([f.v_mag for f in screened.frames]),
        stars.pixels,
        fit.residual_px,
        before,
        fit.used,
    )
