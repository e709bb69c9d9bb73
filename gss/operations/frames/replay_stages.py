"""Compares on-board and ground results stage by stage, in processing order: equal, difference, or not sent by the device."""

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

# Tolerances: positions, flux, weights and sigmas are sent as 32-bit floats, the quaternion as 64-bit.
WIRE_PX, WIRE_SHARE, WIRE_QUATERNION = 1e-4, 1e-6, 1e-12
REASON_BYTES = 200
"""Maximum length of a reason as sent."""
SHOWN = 3


class StageVerdict(StrEnum):
    """Result of comparing one stage."""

    EQUAL = "equal"
    DIFFERS = "differs"
    NOT_SENT = "not sent"
    NOT_COMPARED = "not compared"


@dataclass(frozen=True)
class ReplayStage:
    """One row of the comparison. ``difference``: as text, empty if there is none; ``difference_px`` on the detector,
    ``difference_arcsec`` on the sky, None if not applicable."""

    name: str
    verdict: StageVerdict
    on_board: str
    ground: str
    difference: str = ""
    difference_px: float | None = None
    difference_arcsec: float | None = None


@dataclass(frozen=True)
class Rerun:
    """The ground's run. ``detection`` and ``matching``: the chain's intermediate results."""

    result: SolveResult
    detection: Detection | None = None
    matching: Any = None


def stages(record: OnboardRecord, rerun: Rerun) -> list[ReplayStage]:
    """Compare every stage, even after one that differs."""
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


def _counted(number: int, what: str) -> str:
    return f"{number} {what}{'' if number == 1 else 's'}"


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
    theirs, detection = record.detected.get("regions_invalid"), rerun.detection
    if theirs is None or detection is None:
        return ReplayStage(
            "regions rejected", StageVerdict.NOT_SENT, "not sent", _ground(detection and detection.invalid)
        )
    ours = min(255, detection.invalid)
    text = f"regions rejected differ: {theirs} on board, {ours} on the ground"
    return _judged("regions rejected", str(theirs), str(ours), int(theirs) != ours, text)


def _black(record: OnboardRecord, rerun: Rerun) -> ReplayStage:
    theirs, detection = record.detected.get("background_dn"), rerun.detection
    if theirs is None or detection is None:
        return ReplayStage(
            "black level", StageVerdict.NOT_SENT, "not sent", _ground(detection and f"{detection.black_dn:.4g} DN")
        )
    ours = detection.black_dn
    text = f"black level differs: {theirs:.6g} DN on board, {ours:.6g} DN on the ground"
    return _judged("black level", f"{theirs:.6g} DN", f"{ours:.6g} DN", not _near(float(theirs), ours), text)


def _ground(value: Any) -> str:
    return "–" if value is None else str(value)


def _near(a: float, b: float) -> bool:
    return math.isclose(a, b, rel_tol=WIRE_SHARE, abs_tol=WIRE_SHARE)


def _count(record: OnboardRecord, rerun: Rerun) -> ReplayStage:
    theirs, ours = len(record.centroids), len(rerun.result.centroids)
    text = f"centroids differ: {theirs} on board, {ours} on the ground"
    return _judged("centroids", str(theirs), str(ours), theirs != ours, text)


def _places(record: OnboardRecord, rerun: Rerun) -> ReplayStage:
    theirs = np.array([[row["col_px"], row["row_px"]] for row in record.centroids], float).reshape(-1, 2)
    ours = rerun.result.centroids.pixels
    n = min(len(theirs), len(ours))
    gap = np.abs(theirs[:n] - ours[:n]).max(axis=1) if n else np.zeros(0)
    off = np.flatnonzero(gap > WIRE_PX)
    if not len(off):
        shown = f"{_counted(n, 'place')}" if n else "none"
        return _judged("places", shown, shown, False, difference_px=float(gap.max()) if n else None)
    k = int(off[0])
    arcsec = float(gap[k]) * rerun.result.camera.pixel_rad / ARCSEC_RAD
    a, b = (f"{k}: {p[0]:.4f}, {p[1]:.4f}" for p in (theirs[k], ours[k]))
    text = f"centroid {k} differs by {gap[k]:.4f} px"
    return _judged("places", a, b, True, text, difference_px=float(gap[k]), difference_arcsec=arcsec)


def _light(record: OnboardRecord, rerun: Rerun) -> ReplayStage:
    c = rerun.result.centroids  # the peak is sent as an integer
    for k, row in enumerate(record.centroids[: len(c)]):
        ours = {"flux_dn": float(c.flux_dn[k]), "peak_dn": int(c.peak_dn[k]), "area_px": float(c.area_px[k])}
        for name, value in ours.items():
            if name in row and not _near(float(row[name]), value):
                what = name.rpartition("_")[0]
                text = f"{what} of centroid {k} differs: {row[name]:g} on board, {value:g} on the ground"
                return _judged("light", f"{k}: {what} {row[name]:g}", f"{k}: {what} {value:g}", True, text)
    shown = "flux, peak and area"
    return _judged("light", shown, shown, False)


def _ours_matched(rerun: Rerun) -> dict[int, tuple[int, float]] | None:
    """Return row of the bank and weight by centroid, from the chain's matching."""
    m = rerun.matching
    if m is None:
        return None
    return {int(i): (int(m.row[i]), float(m.weight[i])) for i in m.selected}


def _theirs_matched(record: OnboardRecord) -> dict[int, tuple[int, float]]:
    return {int(row["centroid"]): (int(row["star"]), float(row["weight"])) for row in record.matches}


def _matches(record: OnboardRecord, rerun: Rerun) -> ReplayStage:
    theirs, ours = _theirs_matched(record), _ours_matched(rerun)
    if ours is None:
        matches = rerun.result.matches
        if matches is None or record.attitude is None or record.attitude.get("outcome") != "solved":
            return ReplayStage("matches", StageVerdict.NOT_COMPARED, _counted(len(theirs), "star"), "–")
        text = f"matches differ: {len(theirs)} on board, {len(matches)} on the ground"
        return _judged("matches", str(len(theirs)), str(len(matches)), len(theirs) != len(matches), text)
    odd = sorted(i for i in theirs.keys() | ours.keys() if _row(theirs, i) != _row(ours, i))
    if not odd:
        return _judged("matches", _counted(len(theirs), "star"), _counted(len(ours), "star"), False)
    a, b = (", ".join(_name(side, i, record) for i in odd[:SHOWN]) for side in (theirs, ours))
    first, second = (_star(side, odd[0], record) for side in (theirs, ours))
    text = f"matches differ: centroid {odd[0]} is {first} on board, {second} on the ground"
    return _judged("matches", f"{len(theirs)}: {a}", f"{len(ours)}: {b}", True, text)


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
    theirs, ours = _theirs_matched(record), _ours_matched(rerun)
    if ours is None:
        return ReplayStage("weights", StageVerdict.NOT_COMPARED, _counted(len(theirs), "weight"), "–")
    for i in sorted(theirs.keys() & ours.keys()):
        if not _near(theirs[i][1], ours[i][1]):
            text = f"weight of centroid {i} differs: {theirs[i][1]:g} on board, {ours[i][1]:g} on the ground"
            return _judged("weights", f"{i}: {theirs[i][1]:g}", f"{i}: {ours[i][1]:g}", True, text)
    both = len(theirs.keys() & ours.keys())
    return _judged("weights", _counted(both, "weight"), _counted(both, "weight"), False)


def _mode(record: OnboardRecord, rerun: Rerun) -> ReplayStage:
    if record.attitude is None or "mode" not in record.attitude:
        return ReplayStage("mode", StageVerdict.NOT_SENT, "not sent", _ground(getattr(rerun.matching, "mode", None)))
    theirs = str(record.attitude["mode"])
    ours = theirs if rerun.matching is None else str(rerun.matching.mode)
    text = f"mode differs: {theirs} on board, {ours} on the ground"
    return _judged("mode", theirs.replace("_", " "), ours.replace("_", " "), theirs != ours, text)


def _outcome(record: OnboardRecord, rerun: Rerun) -> ReplayStage:
    if record.attitude is None:
        return ReplayStage("outcome", StageVerdict.NOT_SENT, "not sent", str(rerun.result.outcome))
    theirs = "solved" if record.attitude.get("outcome") == "solved" else "none"
    ours = "solved" if rerun.result.outcome is Outcome.SOLVED else "none"
    if theirs != ours:
        text = f"outcome differs: {theirs} on board, {ours} on the ground"
        return _judged("outcome", theirs, f"{ours}: {rerun.result.reason}".rstrip(": "), True, text)
    said = str(record.attitude.get("reason") or "")
    reported = rerun.result.reason.encode()[:REASON_BYTES].decode(errors="ignore")
    text = f"reason differs: “{said}” on board, “{reported}” on the ground"
    return _judged("outcome", said or theirs, reported or ours, bool(said) and said != reported, text)


def _quaternion(record: OnboardRecord, rerun: Rerun) -> ReplayStage:
    reported, attitude = record.attitude, rerun.result.attitude
    if reported is None or reported.get("outcome") != "solved" or attitude is None:
        none = reported is not None and reported.get("outcome") != "solved"
        verdict = StageVerdict.NOT_COMPARED if reported is not None else StageVerdict.NOT_SENT
        return ReplayStage(
            "quaternion", verdict, "none" if none else "not sent", "none" if attitude is None else "has one"
        )
    theirs = np.array([float(reported[f"quaternion_{a}"]) for a in "xyzw"])
    theirs = theirs * (1.0 if theirs @ attitude.quaternion >= 0 else -1.0)
    step = float(np.abs(theirs - attitude.quaternion).max())
    cross_rad, about_rad = pointing_difference_rad(
        matrix_from_quaternion(theirs / np.linalg.norm(theirs)), attitude.cam_from_icrs
    )
    arcsec = float(np.hypot(cross_rad, about_rad)) / ARCSEC_RAD
    a, b = (" ".join(f"{v:.12f}" for v in q) for q in (theirs, attitude.quaternion))
    differs = step > WIRE_QUATERNION
    text = f"quaternion differs by {step:.1e}"
    px = cross_rad / rerun.result.camera.pixel_rad
    return _judged("quaternion", a, b, differs, text, difference_px=px, difference_arcsec=arcsec)


def _sigma(record: OnboardRecord, rerun: Rerun) -> ReplayStage:
    reported, attitude = record.attitude or {}, rerun.result.attitude
    if attitude is None or reported.get("sigma_cross_arcsec") is None or reported.get("outcome") != "solved":
        return ReplayStage(
            "standard deviations", StageVerdict.NOT_COMPARED if reported else StageVerdict.NOT_SENT, "–", "–"
        )
    theirs = [float(reported[f"sigma_{axis}_arcsec"]) for axis in ("cross", "roll")]
    ours = [float(s) / ARCSEC_RAD for s in attitude.sigma_rad]
    differs = any(
        not (_near(a, b) or not (math.isfinite(a) or math.isfinite(b))) for a, b in zip(theirs, ours, strict=True)
    )
    a, b = (f"{s[0]:.2f}″ across, {s[1]:.2f}″ about" for s in (theirs, ours))
    return _judged("standard deviations", a, b, differs, f"standard deviations differ: {a} on board, {b} on the ground")
