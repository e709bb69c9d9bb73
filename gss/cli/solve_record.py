"""Output of ``gss solve`` for an image: a JSON object, or lines of text."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NotRequired, TypedDict

import numpy as np

from gss.domain.angles import ARCSEC_RAD
from gss.domain.results import Outcome, SolveResult, Turning

if TYPE_CHECKING:
    from gss.operations.frames.image_sequence import RateRecord, TruthRecord


class TurningRecord(TypedDict):
    """Angular rate about camera x, y, z, measured from star trails of a frame."""

    deg_s: list[float]
    sigma_deg_s: list[float]
    speed_deg_s: float
    sign_known: bool
    stars: int


class SolveRecord(TypedDict):
    """Result of an image as a JSON object. Missing values are null. ``rate``: angular rate since the previous image of
    a sequence; ``truth``: comparison with the true attitude."""

    file: str
    chain: str
    outcome: str
    reason: str
    ra_deg: float | None
    dec_deg: float | None
    roll_deg: float | None
    quaternion: list[float] | None
    sigma_arcsec: float | None
    sigma_roll_arcsec: float | None
    matched: int
    centroids: int
    false_match_probability: float | None
    fov_deg: list[float] | None
    residual_rms_px: float | None
    turning: TurningRecord | None
    aberration_arcsec: float | None
    versions: dict[str, str]
    timing_ms: dict[str, float]
    notes: list[str]
    rate: NotRequired[RateRecord | None]
    truth: NotRequired[TruthRecord | None]


def as_record(name: str, result: SolveResult) -> SolveRecord:
    """Return the result of an image as a JSON object. Missing values are null."""
    record: SolveRecord = {
        "file": name,
        "chain": result.chain,
        "outcome": str(result.outcome),
        "reason": result.reason,
        "ra_deg": None,
        "dec_deg": None,
        "roll_deg": None,
        "quaternion": None,
        "sigma_arcsec": None,
        "sigma_roll_arcsec": None,
        "matched": 0 if result.matches is None else len(result.matches),
        "centroids": len(result.centroids),
        "false_match_probability": _finite(result.false_match_probability),
        "fov_deg": None,
        "residual_rms_px": _finite(result.residual_rms_px),
        "turning": None if result.turning is None else turning_record(result.turning),
        "aberration_arcsec": None if result.velocity_c is None else math.hypot(*result.velocity_c) / ARCSEC_RAD,
        "versions": dict(result.versions),
        "timing_ms": {stage: round(1e3 * s, 3) for stage, s in result.timing_s.items()},
        "notes": list(result.notes),
    }
    if result.attitude is not None:
        ra, dec, roll = result.attitude.ra_dec_roll_rad
        cross, about = result.attitude.sigma_rad
        record |= {
            "ra_deg": round(math.degrees(ra), 7),
            "dec_deg": round(math.degrees(dec), 7),
            "roll_deg": round(math.degrees(roll), 6),
            "quaternion": [float(q) for q in result.attitude.quaternion],
            "sigma_arcsec": _finite(cross / ARCSEC_RAD),
            "sigma_roll_arcsec": _finite(about / ARCSEC_RAD),
            "fov_deg": [round(math.degrees(f), 5) for f in result.camera.fov_rad],
        }
    return record


def turning_record(turning: Turning) -> TurningRecord:
    """Return the angular rate of a frame with trails, in degrees per second about camera x, y, z."""
    return {
        "deg_s": [math.degrees(v) for v in turning.vector_rad_s],
        "sigma_deg_s": [math.degrees(v) for v in turning.sigma_rad_s],
        "speed_deg_s": math.degrees(turning.speed_rad_s),
        "sign_known": turning.sign_known,
        "stars": turning.stars,
    }


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def as_text(record: SolveRecord) -> str:
    """Return the result as a few lines of text."""
    total_ms = sum(record["timing_ms"].values())
    if record["outcome"] != str(Outcome.SOLVED):
        return (
            f"{record['file']}: no solution. {record['reason']}\n  {record['centroids']} stars found, {total_ms:.0f} ms"
        )
    fov = " x ".join(f"{f:.3f}°" for f in record["fov_deg"] or ())
    sigma = (
        ""
        if record["sigma_arcsec"] is None
        else f" ± {record['sigma_arcsec']:.1f}″ per axis, roll ± {record['sigma_roll_arcsec']:.0f}″"
    )
    chance = "unknown" if record["false_match_probability"] is None else f"{record['false_match_probability']:.1e}"
    residual = "unknown" if record["residual_rms_px"] is None else f"{record['residual_rms_px']:.2f} px"
    lines = [
        f"{record['file']}: RA {record['ra_deg']:.5f}°  Dec {record['dec_deg']:+.5f}°  roll {record['roll_deg']:.4f}°{sigma}",
        f"  {record['matched']} of {record['centroids']} stars identified, residual {residual}, "
        f"field of view {fov}, false-match probability {chance}",
        f"  {record['chain']} chain, {total_ms:.0f} ms",
    ]
    rate = record.get("rate")
    if rate is not None:
        x, y, z = rate["deg_s"]
        lines.append(f"  turns at {rate['speed_deg_s']:.5f}°/s: {x:+.5f} {y:+.5f} {z:+.5f} about x, y, z")
    turning = record["turning"]
    if turning is not None:
        x, y, z = turning["deg_s"]
        a, b, c = turning["sigma_deg_s"]
        sign = "" if turning["sign_known"] else " (or the opposite: a trail has no direction)"
        lines.append(
            f"  {turning['stars']} trails: turned at {turning['speed_deg_s']:.4f}°/s during the exposure: {x:+.4f} ± {a:.4f}, "
            f"{y:+.4f} ± {b:.4f}, {z:+.4f} ± {c:.4f} about x, y, z{sign}"
        )
    truth = record.get("truth")
    if truth is not None:
        lines.append(f"  {truth['verdict']}: {truth['error_arcsec']:.1f}″ off, roll {truth['error_roll_arcsec']:+.0f}″")
    return "\n".join(lines + [f"  {note}" for note in record["notes"]])
