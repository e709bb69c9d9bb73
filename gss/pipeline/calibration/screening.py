"""Screening of frames for a calibration. Unsuitable frames are excluded with a reason, and warnings about the remaining
frames are returned."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gss.domain.angles import Array
from gss.domain.camera import Camera
from gss.domain.words import counted, verb
from gss.pipeline.attitude import svd
from gss.pipeline.calibration.advice import Advice
from gss.pipeline.calibration.sightings import FrameStars

MIN_STARS = 3
FEW_FRAMES = 5
FEW_STARS = 40
STREAK_PX = 3.0
SATURATED_SHARE = 0.2
SCALE_GAP = 0.03
MIRROR_PX, MIRROR_GAIN = 4.0, 5.0
COVERAGE_CELLS = 4
CLOUD_MAG, CLOUD_SHARE = 0.5, 0.5


@dataclass(frozen=True)
class ScreenedFrames:
    """Frames to use, without saturated stars. ``scale``: plate scale of each relative to the start camera;
    ``excluded``: names of the excluded frames with reasons."""

    frames: tuple[FrameStars, ...]
    scale: Array
    excluded: tuple[tuple[str, str], ...]
    warnings: tuple[Advice, ...]


def screen(frames: Sequence[FrameStars], start: Camera) -> ScreenedFrames:
    """Exclude frames that have another size, too few stars, trails (if enough other frames remain) or another plate
    scale, or are mirrored. ``start``: the camera before calibration."""
    excluded: list[tuple[str, str]] = []
    warnings: list[Advice] = []
    usable = _of_size(frames, start, excluded, warnings)
    usable = _without_clipped(usable, warnings)
    usable = _with_stars(usable, excluded)
    usable = _steady(usable, excluded, warnings)
    usable = _upright(usable, start, excluded, warnings)
    scale = np.array([plate_scale(f, start)[0] for f in usable])
    usable, scale = _of_one_scale(usable, scale, excluded, warnings)
    warnings += _clouds(usable)
    return ScreenedFrames(tuple(usable), scale, tuple(excluded), tuple(warnings))


def _of_size(
    frames: Sequence[FrameStars], start: Camera, excluded: list[tuple[str, str]], warnings: list[Advice]
) -> list[FrameStars]:
    same_size = [f for f in frames if (f.columns, f.rows) == (start.columns, start.rows)]
    other = [f for f in frames if (f.columns, f.rows) != (start.columns, start.rows)]
    excluded += [(f.name, f"{f.columns} x {f.rows} px: not the size of the camera's detector") for f in other]
    if other:
        warnings.append(
            Advice(
                "mixed-sizes",
                f"{counted(len(other), 'frame')} {verb(len(other), 'is', 'are')} not {start.columns} x {start.rows} px",
                "calibrate each camera, binning and window separately",
            )
        )
    return same_size


def _without_clipped(frames: list[FrameStars], warnings: list[Advice]) -> list[FrameStars]:
    total, clipped = sum(map(len, frames)), sum(int(f.saturated.sum()) for f in frames)
    if total and clipped > SATURATED_SHARE * total:
        warnings.append(
            Advice(
                "saturated",
                f"{clipped} of {total} stars are clipped and were left out",
                "expose shorter, or point away from bright stars",
            )
        )
    return [f.take(~f.saturated) if f.saturated.any() else f for f in frames]


def _with_stars(frames: list[FrameStars], excluded: list[tuple[str, str]]) -> list[FrameStars]:
    excluded += [(f.name, f"{counted(len(f), 'star')}; {MIN_STARS} are needed") for f in frames if len(f) < MIN_STARS]
    return [f for f in frames if len(f) >= MIN_STARS]


def _steady(frames: list[FrameStars], excluded: list[tuple[str, str]], warnings: list[Advice]) -> list[FrameStars]:
    moving = [f for f in frames if f.streak_px > STREAK_PX]
    if not moving:
        return frames
    longest = max(f.streak_px for f in moving)
    text = f"the camera moved during the exposure of {counted(len(moving), 'frame')}: trails up to {longest:.0f} px"
    hint = "fix the camera to the ground, or expose shorter"
    steady = [f for f in frames if f.streak_px <= STREAK_PX]
    if len(steady) < FEW_FRAMES:
        warnings.append(Advice("streaks", text + "; too few others, so they are used", hint, severe=True))
        return frames
    warnings.append(Advice("streaks", text + "; left out", hint))
    excluded += [(f.name, f"trails of {f.streak_px:.0f} px") for f in moving]
    return steady


def _upright(
    frames: list[FrameStars], start: Camera, excluded: list[tuple[str, str]], warnings: list[Advice]
) -> list[FrameStars]:
    mirrored = [is_mirrored(f, start) for f in frames]
    if any(mirrored):
        excluded += [(f.name, "mirrored") for f, bad in zip(frames, mirrored, strict=True) if bad]
        warnings.append(
            Advice(
                "mirrored",
                f"{sum(mirrored)} of {counted(len(frames), 'frame')} mirrored: the mirror image matches the sky better",
                "read the file the right way round, or correct the order of the read-out",
                severe=all(mirrored),
            )
        )
    return [f for f, bad in zip(frames, mirrored, strict=True) if not bad]


def is_mirrored(frame: FrameStars, camera: Camera) -> bool:
    """True if the frame fits its matched stars far better after left and right are exchanged."""
    flipped = frame.pixels * np.array([-1.0, 1.0]) + np.array([camera.columns - 1.0, 0.0])
    plain, other = (_fit_rms_px(p, frame.icrs, camera) for p in (frame.pixels, flipped))
    return len(frame) >= MIN_STARS and plain > MIRROR_PX and other * MIRROR_GAIN < plain


def _predicted(pixels: Array, icrs: Array, camera: Camera) -> tuple[Array, NDArray[np.bool_]]:
    cam = camera.unproject(pixels)
    good: NDArray[np.bool_] = np.asarray(np.isfinite(cam).all(axis=1))
    if good.sum() < 2:
        return np.full_like(pixels, np.nan), good
    predicted = camera.project(icrs @ svd(cam[good], icrs[good]).T)
    return predicted, np.asarray(good & np.isfinite(predicted).all(axis=1))


def _fit_rms_px(pixels: Array, icrs: Array, camera: Camera) -> float:
    predicted, good = _predicted(pixels, icrs, camera)
    return float(np.sqrt(np.mean((pixels - predicted)[good] ** 2))) if good.any() else float("inf")


def plate_scale(frame: FrameStars, camera: Camera) -> tuple[float, float]:
    """Return the plate scale of the frame relative to the camera's, and its σ. It is computed from measured and
    predicted distances from the centre of the stars, and does not depend on the attitude."""
    place, good = _predicted(frame.pixels, frame.icrs, camera)
    if good.sum() < 2:
        return float("nan"), float("nan")
    measured, predicted = (p[good] - p[good].mean(axis=0) for p in (frame.pixels, place))
    square = float(np.sum(predicted**2))
    if square == 0:
        return float("nan"), float("nan")
    return float(np.sum(measured * predicted)) / square, float(np.median(frame.sigma_px)) / np.sqrt(square)


def _of_one_scale(
    frames: list[FrameStars], scale: Array, excluded: list[tuple[str, str]], warnings: list[Advice]
) -> tuple[list[FrameStars], Array]:
    """Return the largest group of frames without a gap in their scales. The scale of one lens changes gradually, so a
    gap indicates another lens."""
    finite = np.flatnonzero(np.isfinite(scale))
    if len(finite) < 2:
        return frames, scale
    order = finite[np.argsort(scale[finite])]
    groups = np.split(order, np.flatnonzero(np.diff(scale[order]) > SCALE_GAP) + 1)
    largest = max(groups, key=len)
    if len(largest) == len(frames):
        return frames, scale
    keep = np.zeros(len(frames), bool)
    keep[largest] = True
    middle = float(np.median(scale[largest]))
    excluded += [
        (f.name, f"plate scale {s / middle:.3f} times that of the others")
        for f, s, k in zip(frames, scale, keep, strict=True)
        if not k
    ]
    warnings.append(
        Advice(
            "mixed-cameras",
            f"{int((~keep).sum())} of {counted(len(frames), 'frame')} with another plate scale than the others",
            "calibrate frames of one camera with one lens at one focus together",
            severe=int(keep.sum()) < 2 * int((~keep).sum()),
        )
    )
    return [f for f, k in zip(frames, keep, strict=True) if k], scale[keep]


def frame_offsets_mag(frames: Sequence[FrameStars]) -> Array:
    """Return the (f,) median zero points (magnitude of one DN per second) of the frames minus the median of all; NaN
    without fluxes."""
    zero_points = []
    for f in frames:
        good = np.isfinite(f.flux_dn) & (f.flux_dn > 0) & np.isfinite(f.v_mag) & ~f.saturated
        # Equal fluxes mean that the centroids were stored without fluxes.
        if good.sum() < MIN_STARS or np.ptp(f.flux_dn[good]) == 0:
            zero_points.append(np.nan)
            continue
        exposure_s = f.exposure_s if np.isfinite(f.exposure_s) else 1.0
        zero_points.append(float(np.median(f.v_mag[good] + 2.5 * np.log10(f.flux_dn[good] / exposure_s))))
    zero = np.array(zero_points)
    return np.asarray(zero - np.nanmedian(zero)) if np.isfinite(zero).any() else zero


def _clouds(frames: Sequence[FrameStars]) -> list[Advice]:
    if len(frames) < FEW_FRAMES:
        return []
    offsets = frame_offsets_mag(frames)
    counts = np.array([len(f) for f in frames])
    dim = np.flatnonzero(np.isfinite(offsets) & (offsets < -CLOUD_MAG))
    sparse = np.flatnonzero(counts < CLOUD_SHARE * np.median(counts))
    if not len(dim) and len(sparse) < max(2, 0.15 * len(frames)):
        return []
    parts = []
    if len(dim):
        parts.append(f"stars of {counted(len(dim), 'frame')} are more than {CLOUD_MAG} mag too faint")
    if len(sparse):
        parts.append(
            f"{counted(len(sparse), 'frame')} {verb(len(sparse), 'has', 'have')} less than half as many stars as the others"
        )
    names = ", ".join(frames[k].name for k in sorted({*dim.tolist(), *sparse.tolist()})[:5])
    return [
        Advice(
            "clouds",
            f"{' and '.join(parts)} ({names})",
            "clouds or haze: repeat under a clear sky, or exclude these frames",
        )
    ]


def coverage(pixels: Array, size: tuple[int, int]) -> float:
    """Return the share of the cells of a 4 x 4 grid over the detector that contain a star."""
    cell = np.clip((pixels + 0.5) * COVERAGE_CELLS / np.array(size), 0, COVERAGE_CELLS - 1).astype(int)
    return len({(c, r) for c, r in cell.tolist()}) / COVERAGE_CELLS**2


def poor_data(pixels: Array, frames: int, size: tuple[int, int]) -> list[Advice]:
    """Return warnings about the remaining stars."""
    advice: list[Advice] = []
    if len(pixels) < FEW_STARS:
        text = f"{counted(len(pixels), 'star')} in all"
        advice.append(
            Advice("few-stars", text, f"take more frames, until there are {FEW_STARS} or better 300 stars", True)
        )
    if frames < FEW_FRAMES:
        advice.append(Advice("few-frames", counted(frames, "frame"), "take 20 or more at different rotations"))
    share = coverage(pixels, size) if len(pixels) else 0.0
    if share < 0.8:
        text = f"stars in {share:.0%} of the field only"
        hint = "point so that stars cover every part of the detector, including the corners; rotate the camera between frames"
        advice.append(Advice("one-part", text, hint, severe=share < 0.4))
    return advice
