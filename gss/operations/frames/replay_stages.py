"""Comparison of on-board and ground results by stage, in processing order. Each stage is equal, different, not sent by the device,
or not compared."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

import numpy as np

from gss.domain.angles import ARCSEC_RAD
from gss.domain.frames import pointing_difference_rad
from gss.domain.results import Outcome, SolveResult
from gss.domain.rotation import matrix_from_quaternion
from gss.operations.frames.onboard_results import OnboardRecord
from gss.pipeline.chains.onboard import Detection

# Tolerances. The device sends positions, flux, weights and sigmas as 32-bit floats, and the quaternion as 64-bit
# floats.
WIRE_PX, WIRE_SHARE, WIRE_QUATERNION = 1e-4, 1e-6, 1e-12
REASON_BYTES = 200
"""Maximum length of a reason in a packet."""
SHOWN = 3


class StageVerdict(StrEnum):
    """Result of comparing one stage."""

    EQUAL = "equal"
    DIFFERS = "differs"
    NOT_SENT = "not sent"
    NOT_COMPARED = "not compared"


@dataclass(frozen=True)
class ReplayStage:
    """Comparison of one stage. ``difference``: difference as text, empty if there is none. ``difference_px``: difference on the
    detector. ``difference_arcsec``: difference on the sky. Both are None if not applicable."""

    name: str
    verdict: StageVerdict
    on_board: str
    ground: str
    difference: str = ""
    difference_px: float | None = None
    difference_arcsec: float | None = None


@dataclass(frozen=True)
class Rerun:
    """Result of a rerun on the ground. ``detection``, ``matching``: intermediate results of the chain."""

    result: SolveResult
    detection: Detection | None = None
    matching: Any = None


def stages(record: OnboardRecord, rerun: Rerun) -> list[ReplayStage]:
    """Compare all stages, including those after a stage that differs."""
    return [
        _regions(record, rerun),
        _black(record, rerun),
        _count(record, rerun),
        _places(record, rerun),
        _light(record, rerun),
        ReplayStage(
            "unit vectors", StageVerdict.NOT_SENT, "not sent", _counted(len(rerun.result.centroids), "direction")
        ),
        _matches(record, rerun),
        _weights(record, rerun),
        _mode(record, rerun),
        _outcome(record, rerun),
        _quaternion(record, rerun),
        _sigma(record, rerun),
    ]


def first_difference(stages: Sequence[ReplayStage]) -> str:
    """Return "equal" or the text of the first stage that differs."""
    return next((s.difference for s in stages if s.verdict is StageVerdict.DIFFERS), "equal")


def _counted(number: int, noun: str) -> str:
    return f"{number} {noun}{'' if number == 1 else 's'}"


def _judged(
    name: str, on_board: str, ground: str, differs: bool, difference: str = "", **by: float | None
) -> ReplayStage:
    return ReplayStage(
        name,
        StageVerdict.DIFFERS if differs else StageVerdict.EQUAL,
        on_board,
        ground,
        difference if differs else "",
        **by,
    )


def _regions(record: OnboardRecord, rerun: Rerun) -> ReplayStage:
    device, detection = record.detected.get("regions_invalid"), rerun.detection
    if device is None or detection is None:
        return ReplayStage(
            "regions rejected", StageVerdict.NOT_SENT, "not sent", _ground(detection and detection.invalid)
        )
    on_ground = min(255, detection.invalid)
    text = f"regions rejected differ: {device} on board, {on_ground} on the ground"
    return _judged("regions rejected", str(device), str(on_ground), int(device) != on_ground, text)


def _black(record: OnboardRecord, rerun: Rerun) -> ReplayStage:
    device, detection = record.detected.get("background_dn"), rerun.detection
    if device is None or detection is None:
        return ReplayStage(
            "black level", StageVerdict.NOT_SENT, "not sent", _ground(detection and f"{detection.black_dn:.4g} DN")
        )
    on_ground = detection.black_dn
    text = f"black level differs: {device:.6g} DN on board, {on_ground:.6g} DN on the ground"
    return _judged("black level", f"{device:.6g} DN", f"{on_ground:.6g} DN", not _near(float(device), on_ground), text)


def _ground(value: Any) -> str:
    return "–" if value is None else str(value)


def _near(device: float, on_ground: float) -> bool:
    return math.isclose(device, on_ground, rel_tol=WIRE_SHARE, abs_tol=WIRE_SHARE)


def _count(record: OnboardRecord, rerun: Rerun) -> ReplayStage:
    device, on_ground = len(record.centroids), len(rerun.result.centroids)
    text = f"centroids differ: {device} on board, {on_ground} on the ground"
    return _judged("centroids", str(device), str(on_ground), device != on_ground, text)


def _places(record: OnboardRecord, rerun: Rerun) -> ReplayStage:
    device = np.array([[row["col_px"], row["row_px"]] for row in record.centroids], float).reshape(-1, 2)
    on_ground = rerun.result.centroids.pixels
    n = min(len(device), len(on_ground))
    gap = np.abs(device[:n] - on_ground[:n]).max(axis=1) if n else np.zeros(0)
    different = np.flatnonzero(gap > WIRE_PX)
    if not len(different):
        shown = f"{_counted(n, 'place')}" if n else "none"
        return _judged("places", shown, shown, False, difference_px=float(gap.max()) if n else None)
    k = int(different[0])
    arcsec = float(gap[k]) * rerun.result.camera.pixel_rad / ARCSEC_RAD
    device_text, ground_text = (f"{k}: {p[0]:.4f}, {p[1]:.4f}" for p in (device[k], on_ground[k]))
    text = f"centroid {k} differs by {gap[k]:.4f} px"
    return _judged(
        "places", device_text, ground_text, True, text, difference_px=float(gap[k]), difference_arcsec=arcsec
    )


def _light(record: OnboardRecord, rerun: Rerun) -> ReplayStage:
    centroids = rerun.result.centroids  # the device sends the peak as an integer
    for k, row in enumerate(record.centroids[: len(centroids)]):
        on_ground = {
            "flux_dn": float(centroids.flux_dn[k]),
            "peak_dn": int(centroids.peak_dn[k]),
            "area_px": float(centroids.area_px[k]),
        }
        for name, value in on_ground.items():
            if name in row and not _near(float(row[name]), value):
                quantity = name.rpartition("_")[0]
                text = f"{quantity} of centroid {k} differs: {row[name]:g} on board, {value:g} on the ground"
                return _judged("light", f"{k}: {quantity} {row[name]:g}", f"{k}: {quantity} {value:g}", True, text)
    shown = "flux, peak and area"
    return _judged("light", shown, shown, False)


def _ground_matched(rerun: Rerun) -> dict[int, tuple[int, float]] | None:
    """Return centroid to (row of the bank, weight) from the matching of the ground's chain."""
    matching = rerun.matching
    if matching is None:
        return None
    return {int(i): (int(matching.row[i]), float(matching.weight[i])) for i in matching.selected}


def _device_matched(record: OnboardRecord) -> dict[int, tuple[int, float]]:
    return {int(row["centroid"]): (int(row["star"]), float(row["weight"])) for row in record.matches}


def _matches(record: OnboardRecord, rerun: Rerun) -> ReplayStage:
    device, on_ground = _device_matched(record), _ground_matched(rerun)
    if on_ground is None:
        matches = rerun.result.matches
        if matches is None or record.attitude is None or record.attitude.get("outcome") != "solved":
            return ReplayStage("matches", StageVerdict.NOT_COMPARED, _counted(len(device), "star"), "–")
        text = f"matches differ: {len(device)} on board, {len(matches)} on the ground"
        return _judged("matches", str(len(device)), str(len(matches)), len(device) != len(matches), text)
    different = sorted(i for i in device.keys() | on_ground.keys() if _row(device, i) != _row(on_ground, i))
    if not different:
        return _judged("matches", _counted(len(device), "star"), _counted(len(on_ground), "star"), False)
    device_text, ground_text = (
        ", ".join(_name(side, i, record) for i in different[:SHOWN]) for side in (device, on_ground)
    )
    first, second = (_star(side, different[0], record) for side in (device, on_ground))
    text = f"matches differ: centroid {different[0]} is {first} on board, {second} on the ground"
    return _judged("matches", f"{len(device)}: {device_text}", f"{len(on_ground)}: {ground_text}", True, text)


def _row(side: Mapping[int, tuple[int, float]], centroid: int) -> int | None:
    return side[centroid][0] if centroid in side else None


def _star(side: Mapping[int, tuple[int, float]], centroid: int, record: OnboardRecord) -> str:
    row = _row(side, centroid)
    if row is None:
        return "no star"
    hips = record.hip_of_row
    return f"HIP {hips[row]}" if hips is not None and 0 <= row < len(hips) else f"row {row}"


def _name(side: Mapping[int, tuple[int, float]], centroid: int, record: OnboardRecord) -> str:
    return f"{centroid} → {_star(side, centroid, record)}"


def _weights(record: OnboardRecord, rerun: Rerun) -> ReplayStage:
    device, on_ground = _device_matched(record), _ground_matched(rerun)
    if on_ground is None:
        return ReplayStage("weights", StageVerdict.NOT_COMPARED, _counted(len(device), "weight"), "–")
    for i in sorted(device.keys() & on_ground.keys()):
        if not _near(device[i][1], on_ground[i][1]):
            text = f"weight of centroid {i} differs: {device[i][1]:g} on board, {on_ground[i][1]:g} on the ground"
            return _judged("weights", f"{i}: {device[i][1]:g}", f"{i}: {on_ground[i][1]:g}", True, text)
    both = len(device.keys() & on_ground.keys())
    return _judged("weights", _counted(both, "weight"), _counted(both, "weight"), False)


def _mode(record: OnboardRecord, rerun: Rerun) -> ReplayStage:
    if record.attitude is None or "mode" not in record.attitude:
        return ReplayStage("mode", StageVerdict.NOT_SENT, "not sent", _ground(getattr(rerun.matching, "mode", None)))
    device = str(record.attitude["mode"])
    on_ground = device if rerun.matching is None else str(rerun.matching.mode)
    text = f"mode differs: {device} on board, {on_ground} on the ground"
    return _judged("mode", device.replace("_", " "), on_ground.replace("_", " "), device != on_ground, text)


def _outcome(record: OnboardRecord, rerun: Rerun) -> ReplayStage:
    if record.attitude is None:
        return ReplayStage("outcome", StageVerdict.NOT_SENT, "not sent", str(rerun.result.outcome))
    device = "solved" if record.attitude.get("outcome") == "solved" else "none"
    on_ground = "solved" if rerun.result.outcome is Outcome.SOLVED else "none"
    if device != on_ground:
        text = f"outcome differs: {device} on board, {on_ground} on the ground"
        return _judged("outcome", device, f"{on_ground}: {rerun.result.reason}".rstrip(": "), True, text)
    stated_reason = str(record.attitude.get("reason") or "")
    reported = rerun.result.reason.encode()[:REASON_BYTES].decode(errors="ignore")
    text = f"reason differs: “{stated_reason}” on board, “{reported}” on the ground"
    differs = bool(stated_reason) and stated_reason != reported
    return _judged("outcome", stated_reason or device, reported or on_ground, differs, text)


def _quaternion(record: OnboardRecord, rerun: Rerun) -> ReplayStage:
    reported, attitude = record.attitude, rerun.result.attitude
    if reported is None or reported.get("outcome") != "solved" or attitude is None:
        none = reported is not None and reported.get("outcome") != "solved"
        verdict = StageVerdict.NOT_COMPARED if reported is not None else StageVerdict.NOT_SENT
        return ReplayStage(
            "quaternion", verdict, "none" if none else "not sent", "none" if attitude is None else "has one"
        )
    device = np.array([float(reported[f"quaternion_{a}"]) for a in "xyzw"])
    device = device * (1.0 if device @ attitude.quaternion >= 0 else -1.0)
    step = float(np.abs(device - attitude.quaternion).max())
    cross_rad, about_rad = pointing_difference_rad(
        matrix_from_quaternion(device / np.linalg.norm(device)), attitude.cam_from_icrs
    )
    arcsec = float(np.hypot(cross_rad, about_rad)) / ARCSEC_RAD
    device_text, ground_text = (" ".join(f"{v:.12f}" for v in q) for q in (device, attitude.quaternion))
    differs = step > WIRE_QUATERNION
    text = f"quaternion differs by {step:.1e}"
    px = cross_rad / rerun.result.camera.pixel_rad
    return _judged("quaternion", device_text, ground_text, differs, text, difference_px=px, difference_arcsec=arcsec)


def _sigma(record: OnboardRecord, rerun: Rerun) -> ReplayStage:
    reported, attitude = record.attitude or {}, rerun.result.attitude
    if attitude is None or reported.get("sigma_cross_arcsec") is None or reported.get("outcome") != "solved":
        return ReplayStage(
            "standard deviations", StageVerdict.NOT_COMPARED if reported else StageVerdict.NOT_SENT, "–", "–"
        )
    device = [float(reported[f"sigma_{axis}_arcsec"]) for axis in ("cross", "roll")]
    on_ground = [float(s) / ARCSEC_RAD for s in attitude.sigma_rad]
    differs = any(
        not (_near(a, b) or not (math.isfinite(a) or math.isfinite(b))) for a, b in zip(device, on_ground, strict=True)
    )
    a, b = (f"{s[0]:.2f}″ across, {s[1]:.2f}″ about" for s in (device, on_ground))
    return _judged("standard deviations", a, b, differs, f"standard deviations differ: {a} on board, {b} on the ground")
