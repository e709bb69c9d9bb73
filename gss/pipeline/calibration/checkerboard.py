"""Camera calibration from checkerboard images by Zhang's method; requires OpenCV (Erlank 2013 §5.4)."""

from __future__ import annotations

import importlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gss.domain.angles import Array
from gss.domain.camera import Brown, Camera
from gss.domain.errors import BadInput
from gss.domain.words import counted
from gss.pipeline.calibration.advice import Advice

NAMES = ("focal_col_px", "focal_row_px", "centre_col_px", "centre_row_px", "k1", "k2", "p1", "p2", "k3")
MIN_IMAGES = 3
FEW_IMAGES = 8
COVERED = 0.7
GRID = 8
UPRIGHT_RAD = 0.25


@dataclass(frozen=True)
class CheckerboardCalibration:
    """Result of a checkerboard calibration. ``values`` and ``sigma`` of the parameters ``names``; σ is 0 if a parameter
    was not fitted. ``found``: for each image, True if the board was detected; ``rms_px``: residual for each image per
    axis, NaN if no board was detected; ``residual_rms_px``: residual of all images per axis. ``covered``: share of the
    field covered by corners."""

    camera: Camera
    names: tuple[str, ...]
    values: tuple[float, ...]
    sigma: tuple[float, ...]
    residual_rms_px: float
    rms_px: tuple[float, ...]
    found: tuple[bool, ...]
    corners_px: Array
    residual_px: Array
    covered: float
    warnings: tuple[Advice, ...]


def opencv() -> Any:
    """Return the OpenCV module. Raises BadInput with installation instructions if it is not installed."""
    try:
        return importlib.import_module("cv2")
    except ImportError:
        raise BadInput(
            "calibration from checkerboard images needs OpenCV, which is not installed",
            expected="the optional package checkerboard",
            got="no module cv2",
            hint='pip install "gss-startracker[checkerboard]"; or calibrate from star frames, which needs nothing more',
        ) from None


def calibrate_checkerboard(
    images: Sequence[NDArray[Any]], inner_corners: tuple[int, int], square_mm: float, *, fit_k3: bool = False
) -> CheckerboardCalibration:
    """Calibrate from (rows, columns) images of a board with squares of ``square_mm``. ``inner_corners``: numbers
    (across, down) of corners at which four squares meet."""
    cv = opencv()
    if min(inner_corners) < 3 or not square_mm > 0:
        raise BadInput(
            "this is not a valid checkerboard",
            expected="3 or more inner corners in both directions",
            got=str(inner_corners),
        )
    sizes = {np.shape(i) for i in images}
    if len(images) < MIN_IMAGES or len(sizes) != 1 or len(next(iter(sizes))) != 2:
        raise BadInput(
            "these pictures cannot be calibrated together",
            expected=f"{MIN_IMAGES} or more grey pictures of one size",
            got=f"{len(images)} of sizes {', '.join(map(str, sizes)) or '-'}",
        )
    corners = [_corners(cv, _as_bytes(i), inner_corners) for i in images]
    detected = [c for c in corners if c is not None]
    if len(detected) < MIN_IMAGES:
        raise BadInput(
            "the board was found in too few pictures",
            expected=f"{MIN_IMAGES} with all {inner_corners[0]} x {inner_corners[1]} inner corners",
            got=f"{len(detected)} of {len(images)}",
            hint="count inner corners, not squares; show the complete board with a white rim, sharp and evenly lit",
        )
    rows, columns = next(iter(sizes))
    board = np.zeros((inner_corners[0] * inner_corners[1], 3), np.float32)
    board[:, :2] = np.mgrid[: inner_corners[0], : inner_corners[1]].T.reshape(-1, 2) * square_mm
    flags = 0 if fit_k3 else cv.CALIB_FIX_K3
    _, matrix, lens, turns, shifts, sigma, _, _ = cv.calibrateCameraExtended(
        [board] * len(detected), [s.astype(np.float32) for s in detected], (columns, rows), None, None, flags=flags
    )
    k1, k2, p1, p2, k3 = (float(v) for v in np.ravel(lens)[:5])
    camera = Camera(
        columns,
        rows,
        float(matrix[0, 0]),
        float(matrix[1, 1]),
        float(matrix[0, 2]),
        float(matrix[1, 2]),
        Brown(k1, k2, p1, p2, k3),
    )
    predicted = [
        cv.projectPoints(board, t, s, matrix, lens)[0].reshape(-1, 2) for t, s in zip(turns, shifts, strict=True)
    ]
    off = [s.reshape(-1, 2) - p for s, p in zip(detected, predicted, strict=True)]
    return _result(camera, np.ravel(sigma)[:9], corners, off, [float(np.linalg.norm(np.ravel(t)[:2])) for t in turns])


def _as_bytes(image: NDArray[Any]) -> NDArray[np.uint8]:
    if image.dtype == np.uint8:
        return np.ascontiguousarray(image)
    low, high = float(np.min(image)), float(np.max(image))
    return np.asarray((image - low) * (255.0 / max(high - low, 1e-9)), np.uint8)


def _corners(cv: Any, image: NDArray[np.uint8], inner: tuple[int, int]) -> Array | None:
    detected, corners = cv.findChessboardCornersSB(
        image, inner, flags=cv.CALIB_CB_ACCURACY | cv.CALIB_CB_NORMALIZE_IMAGE
    )
    return np.asarray(corners, float).reshape(-1, 1, 2) if detected else None


def _result(
    camera: Camera, sigma: Array, corners: Sequence[Array | None], off: list[Array], leaning_rad: list[float]
) -> CheckerboardCalibration:
    residual = np.concatenate(off)
    offsets = iter(off)
    rms = tuple(float("nan") if c is None else float(np.sqrt(np.mean(next(offsets) ** 2))) for c in corners)
    corner_px = np.concatenate([c.reshape(-1, 2) for c in corners if c is not None])
    cell = np.clip((corner_px + 0.5) / np.array([camera.columns, camera.rows]) * GRID, 0, GRID - 1).astype(int)
    covered = len(set(map(tuple, cell.tolist()))) / GRID**2
    values = tuple(float(getattr(camera if n.endswith("_px") else camera.distortion, n)) for n in NAMES)
    advice: list[Advice] = []
    if len(off) < FEW_IMAGES:
        advice.append(Advice("few-frames", f"the board was found in {counted(len(off), 'picture')}", "take 10 to 20"))
    if covered < COVERED:
        text = f"corners of the board in {covered:.0%} of the field only"
        advice.append(Advice("one-part", text, "take images with the board in every corner of the field"))
    if max(leaning_rad) < UPRIGHT_RAD:
        text = "the board faced the camera in all pictures: the focal length is uncertain"
        advice.append(
            Advice("focal", text, "tilt the board by 30° in some images, or measure the focal length from stars")
        )
    rms_all = float(np.sqrt(np.mean(residual**2)))
    detected = tuple(c is not None for c in corners)
    return CheckerboardCalibration(
        camera,
        NAMES,
        values,
        tuple(float(s) for s in sigma),
        rms_all,
        rms,
        detected,
        corner_px,
        residual,
        covered,
        tuple(advice),
    )
