"""Application of a calibration: the calibrated profile, and the difference between two cameras."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from gss.domain.angles import Array
from gss.domain.camera import Camera
from gss.domain.camera_profile import CameraProfile
from gss.domain.errors import BadInput
from gss.domain.sensor import Sensor
from gss.pipeline.attitude import svd
from gss.pipeline.calibration.photometric import PhotometricCalibration
from gss.pipeline.calibration.photon_transfer import PhotonTransfer
from gss.pipeline.calibration.result import CameraCalibration

GRID = 15


@dataclass(frozen=True)
class DetectorFigures:
    """Results of detector calibrations. If a result is None, the value of the profile does not change."""

    gain_e_per_dn: float | None = None
    read_noise_e: float | None = None
    bias_dn: float | None = None
    full_well_e: float | None = None
    dark_current_e_s: float | None = None
    psf_sigma_px: float | None = None


def detector_figures(
    transfer: PhotonTransfer | None = None, dark_current_e_s: float | None = None, psf_sigma_px: float | None = None
) -> DetectorFigures:
    """Collect the results of the detector's calibrations. Results that are NaN are omitted."""

    def finite_or_none(value: float | None) -> float | None:
        return value if value is not None and np.isfinite(value) and value > 0 else None

    dark, psf = finite_or_none(dark_current_e_s), finite_or_none(psf_sigma_px)
    if transfer is None:
        return DetectorFigures(None, None, None, None, dark, psf)
    return DetectorFigures(
        finite_or_none(transfer.gain_e_per_dn),
        finite_or_none(transfer.read_noise_e),
        finite_or_none(transfer.bias_dn),
        finite_or_none(transfer.full_well_e),
        dark,
        psf,
    )


def calibrated_profile(
    profile: CameraProfile,
    geometry: CameraCalibration | Camera | None = None,
    photometry: PhotometricCalibration | None = None,
    detector: DetectorFigures | None = None,
) -> CameraProfile:
    """Return the profile with the calibrated values. Raises BadInput if the detector has another size."""
    camera = geometry.camera if isinstance(geometry, CameraCalibration) else geometry or profile.camera
    if (camera.columns, camera.rows) != (profile.camera.columns, profile.camera.rows):
        raise BadInput(
            "this calibration is for another detector",
            expected=f"{profile.camera.columns} x {profile.camera.rows} px",
            got=f"{camera.columns} x {camera.rows} px",
        )
    sensor = _measured(profile.sensor, detector or DetectorFigures())
    if photometry is not None:
        zero_e_s = photometry.zero_point_dn_s * sensor.gain_e_per_dn
        sensor = replace(sensor, zero_point_e_s=float(zero_e_s))
    focal_px = float(np.sqrt(camera.focal_col_px * camera.focal_row_px))
    pitch_mm = float(np.sqrt(profile.pitch_col_mm * profile.pitch_row_mm))
    sources = dict(profile.sources)
    if geometry is not None:
        sources["geometry"] = "self-calibrated from its own frames"
    return replace(profile, camera=camera, sensor=sensor, focal_mm=focal_px * pitch_mm, sources=sources)


def _measured(sensor: Sensor, figures: DetectorFigures) -> Sensor:
    def or_documented(measured: float | None, documented: float) -> float:
        return documented if measured is None else float(measured)

    return replace(
        sensor,
        gain_e_per_dn=or_documented(figures.gain_e_per_dn, sensor.gain_e_per_dn),
        read_noise_e=or_documented(figures.read_noise_e, sensor.read_noise_e),
        bias_dn=or_documented(figures.bias_dn, sensor.bias_dn),
        full_well_e=or_documented(figures.full_well_e, sensor.full_well_e),
        dark_current_e_s=or_documented(figures.dark_current_e_s, sensor.dark_current_e_s),
        psf_sigma_px=or_documented(figures.psf_sigma_px, sensor.psf_sigma_px),
    )


@dataclass(frozen=True)
class Difference:
    """Difference of two cameras over the detector: ``rms_px`` per axis, and largest length ``max_px``.
    ``rotation_rad``: best-fitting small rotation. It is the attitude difference between the two calibrations, and is
    removed before the difference is computed."""

    rms_px: float
    max_px: float
    rotation_rad: Array


def camera_difference(first: Camera, second: Camera) -> Difference:
    """Compare the mapping of the sky by two cameras with the same detector. Unlike differences of single parameters
    (centre, tilt, focal length), this difference is not affected by correlations of the parameters with each other and
    with the attitude."""
    if (first.columns, first.rows) != (second.columns, second.rows):
        raise BadInput(
            "cameras with different numbers of pixels cannot be compared",
            expected=f"{first.columns} x {first.rows} px",
            got=f"{second.columns} x {second.rows} px",
        )
    col, row = np.meshgrid(np.linspace(0, first.columns - 1, GRID), np.linspace(0, first.rows - 1, GRID))
    pixels = np.column_stack([col.ravel(), row.ravel()])
    rays = first.unproject(pixels)
    good = np.isfinite(rays).all(axis=1) & np.isfinite(second.unproject(pixels)).all(axis=1)
    turn = svd(second.unproject(pixels[good]), rays[good])
    off = second.project(rays[good] @ turn.T) - pixels[good]
    off = off[np.isfinite(off).all(axis=1)]
    skew = (turn - turn.T) / 2
    rotation = np.array([skew[2, 1], skew[0, 2], skew[1, 0]])
    return Difference(
        float(np.sqrt(np.mean(off**2))), float(np.max(np.hypot(off[:, 0], off[:, 1]), initial=0.0)), rotation
    )
