"""Results of a calibration for its page: plain values of the pipeline's records, with thinned lists."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from gss.domain.json_object import JsonObject
from gss.pipeline.calibration.dark import DarkCalibration, Response
from gss.pipeline.calibration.focus import FocusAdvice
from gss.pipeline.calibration.photometric import PhotometricCalibration
from gss.pipeline.calibration.photon_transfer import PhotonTransfer
from gss.pipeline.calibration.plain_values import as_record
from gss.pipeline.calibration.psf_field import PsfField
from gss.pipeline.calibration.result import CameraCalibration, StarResiduals

MAX_POINTS = 4000
MAX_PIXELS = 5000


def geometry(calibration: CameraCalibration) -> JsonObject:
    """Return camera, uncertainties, model comparison, maps before and after, and up to MAX_POINTS residuals for the
    plot."""
    thinned = replace(calibration, stars=_thinned(calibration.stars), warnings=())
    return dict(as_record(thinned))


def _thinned(stars: StarResiduals) -> StarResiduals:
    if len(stars.hip) <= MAX_POINTS:
        return stars
    pick = np.linspace(0, len(stars.hip) - 1, MAX_POINTS).astype(int)
    return replace(
        stars,
        frame=stars.frame[pick],
        hip=stars.hip[pick],
        v_mag=stars.v_mag[pick],
        pixels=stars.pixels[pick],
        residual_px=stars.residual_px[pick],
        before_px=stars.before_px[pick],
        used=stars.used[pick],
    )


def photometry(calibration: PhotometricCalibration) -> JsonObject:
    """Return constants, histogram, and up to MAX_POINTS stars."""
    pick = np.linspace(0, len(calibration.v_mag) - 1, min(len(calibration.v_mag), MAX_POINTS)).astype(int)
    per_star = {name: getattr(calibration, name)[pick] for name in ("frame", "hip", "v_mag", "error_mag", "used")}
    return dict(as_record(replace(calibration, warnings=(), **per_star)))


def psf(psf_field: PsfField, advice: FocusAdvice) -> JsonObject:
    """Return spot widths over the field and the focus advice."""
    return {"field": as_record(replace(psf_field, warnings=())), "focus": as_record(advice)}


def dark(dark: DarkCalibration) -> JsonObject:
    """Return statistics and the hot pixels, hottest first. The maps are not included, because they are stored as
    blobs."""
    order = np.argsort(dark.hot_excess_dn)[::-1][:MAX_PIXELS]
    maps = {"median_dn", "noise_map_dn", "warnings"}
    small = replace(dark, hot=dark.hot[order], hot_excess_dn=dark.hot_excess_dn[order], noisy=dark.noisy[:MAX_PIXELS])
    values = {name: as_record(getattr(small, name)) for name in vars(small) if name not in maps}
    return {**values, "hot_count": len(dark.hot), "noisy_count": len(dark.noisy)}


def response(response_map: Response) -> JsonObject:
    """Return the dead pixels, and the scatter of the response of all other pixels."""
    return {
        "dead": as_record(response_map.dead[:MAX_PIXELS]),
        "dead_count": len(response_map.dead),
        "response_sigma": as_record(response_map.response_sigma),
    }


def photon_transfer(transfer: PhotonTransfer) -> JsonObject:
    """Return gain, read noise and the points of the curve."""
    return dict(as_record(replace(transfer, warnings=())))


def warnings(*parts: Any) -> list[JsonObject]:
    """Return the warnings of all parts of a calibration."""
    return [as_record(advice) for part in parts if part is not None for advice in part.warnings]
