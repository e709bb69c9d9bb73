"""Stored frames as a Rerun recording: picture with overlays, sphere with camera, residuals, log. The only door to rerun."""

from __future__ import annotations

import io
import math
from datetime import datetime
from typing import Any

import numpy as np
from PIL import Image

from gss.domain.angles import Array
from gss.domain.camera_record import camera_from
from gss.domain.rotation import matrix_from_quaternion
from gss.domain.stars import StarTable
from gss.operations.frames import pictures
from gss.operations.frames.frames import FrameService
from gss.store.models import Frame, Solution

JPEG_QUALITY = 90
SPHERE_RADIUS = 10.0
GREEN, BLUE, ORANGE, WHITE, GREY = (95, 211, 166), (91, 183, 240), (244, 149, 63), (255, 255, 255), (133, 145, 160)


def recording(frames: FrameService, frame_ids: list[int], stars: StarTable) -> bytes:
    """.rrd bytes of these frames with the blueprint that shows them; timelines ``frame`` and ``utc``."""
    import rerun as rr  # half a second and 100 MB that only this door pays

    stream = rr.RecordingStream(
        "gss", recording_id=f"gss-frames-{'-'.join(map(str, frame_ids))}"[:120], send_properties=True
    )
    memory = stream.binary_stream()
    stream.send_blueprint(_blueprint(), make_active=True, make_default=True)
    _log_sky(rr, stream, stars)
    for frame_id in frame_ids:
        detail = frames.detail(frame_id)
        _set_times(stream, detail.frame)
        _log_picture(rr, stream, detail.frame, frames)
        if detail.ground is not None:
            _log_solution(rr, stream, detail.ground)
        for solution in detail.solutions:
            _log_text(rr, stream, solution)
        if detail.on_board is not None and detail.ground is not None:
            _log_difference(rr, stream, detail.on_board, detail.ground)
    stream.flush()
    data = memory.read(flush=True)
    return bytes(data or b"")


def _blueprint() -> Any:
    import rerun.blueprint as rrb

    sky = rrb.Spatial3DView(origin="/sky", name="Sky", line_grid=rrb.LineGrid3D(visible=False))
    side = rrb.Vertical(
        rrb.Spatial2DView(origin="/camera/image", name="Frame", contents=["/camera/image/**"]),
        rrb.TimeSeriesView(origin="/attitude", name="Arcseconds"),
        rrb.TextLogView(origin="/log", name="Log"),
        row_shares=[2, 1, 1],
    )
    return rrb.Blueprint(rrb.Horizontal(sky, side, column_shares=[3, 2]), collapse_panels=True)


def _set_times(stream: Any, frame: Frame) -> None:
    stream.set_time("frame", sequence=frame.id)
    moment: datetime = frame.taken
    stream.set_time("utc", timestamp=moment)


def _log_sky(rr: Any, stream: Any, stars: StarTable) -> None:
    bright = stars.brighter_than(4.5)
    radii = np.clip(0.06 * 10 ** (-0.12 * bright.v_mag), 0.01, 0.12)
    labels = [bright.name_of(int(h)) for h in bright.hip]
    points = rr.Points3D(bright.icrs * SPHERE_RADIUS, radii=radii, colors=WHITE, labels=labels, show_labels=False)
    stream.log("sky/stars", points, static=True)
    circles = [_circle(d) for d in (-60, -30, 0, 30, 60)]
    stream.log("sky/grid", rr.LineStrips3D(circles, colors=(48, 59, 71), radii=0.005), static=True)
    stream.log("sky", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)


def _circle(dec_deg: float) -> Array:
    ra, dec = np.linspace(0, 2 * np.pi, 73), math.radians(dec_deg)
    return SPHERE_RADIUS * np.stack(
        [np.cos(dec) * np.cos(ra), np.cos(dec) * np.sin(ra), np.full_like(ra, np.sin(dec))], axis=-1
    )


def _log_picture(rr: Any, stream: Any, frame: Frame, frames: FrameService) -> None:
    pixels = frames.pixels(frame)
    buffer = io.BytesIO()
    Image.fromarray(pictures.apply(pixels, pictures.auto_stretch(pixels))).save(
        buffer, format="JPEG", quality=JPEG_QUALITY
    )
    stream.log("camera/image", rr.EncodedImage(contents=buffer.getvalue(), media_type="image/jpeg"))


def _log_solution(rr: Any, stream: Any, solution: Solution) -> None:
    detail = solution.detail
    regions = [r for r in detail["regions"] if r["rejected"]]
    if regions:
        corners = np.array([[r["col_min"], r["row_min"]] for r in regions], float)
        sizes = np.array([[r["col_max"] - r["col_min"] + 1, r["row_max"] - r["row_min"] + 1] for r in regions], float)
        boxes = rr.Boxes2D(
            mins=corners, sizes=sizes, colors=ORANGE, labels=[r["rejected"] for r in regions], show_labels=False
        )
        stream.log("camera/image/rejected", boxes)
    _log_points(rr, stream, "camera/image/centroids", detail["stars"], WHITE, 1.0)
    _log_points(rr, stream, "camera/image/matched", [s for s in detail["stars"] if s.get("hip")], GREEN, 6.0)
    _log_points(rr, stream, "camera/image/predicted", detail["predicted"], BLUE, 3.0)
    residuals = [math.hypot(s["dx_arcsec"], s["dy_arcsec"]) for s in detail["stars"] if s.get("dx_arcsec") is not None]
    if residuals:
        stream.log("attitude/residual_rms_arcsec", rr.Scalars(float(np.sqrt(np.mean(np.square(residuals))))))
    if solution.quaternion is not None:
        _log_camera(rr, stream, solution)


def _log_points(
    rr: Any, stream: Any, path: str, rows: list[dict[str, Any]], colour: tuple[int, int, int], radius: float
) -> None:
    if not rows:
        return
    # Rerun's picture corner is the corner of a pixel, ours its centre.
    positions = np.array([[row["col_px"] + 0.5, row["row_px"] + 0.5] for row in rows])
    labels = [
        f"{row['name']} {row['v_mag']:.2f}" if row.get("name") and row.get("v_mag") is not None else "" for row in rows
    ]
    stream.log(path, rr.Points2D(positions, colors=colour, radii=radius, labels=labels, show_labels=False))


def _log_camera(rr: Any, stream: Any, solution: Solution) -> None:
    cam_from_icrs = matrix_from_quaternion(np.array(solution.quaternion, float))
    camera = camera_from(solution.camera)
    outline = camera.outline(12) @ cam_from_icrs * SPHERE_RADIUS
    rays = [np.stack([np.zeros(3), corner @ cam_from_icrs * SPHERE_RADIUS]) for corner in camera.corners()]
    stream.log("sky/field", rr.LineStrips3D([np.vstack([outline, outline[:1]]), *rays], colors=BLUE, radii=0.02))
    axes = [cam_from_icrs[k] * 2.0 for k in range(3)]
    colours = [(245, 102, 111), (79, 181, 141), BLUE]
    stream.log("sky/camera_axes", rr.Arrows3D(vectors=axes, colors=colours))


def _log_text(rr: Any, stream: Any, solution: Solution) -> None:
    said = f"{solution.matched} of {solution.found} stars" if solution.outcome == "solved" else solution.reason
    level = "INFO" if solution.outcome == "solved" else "WARN"
    stream.log("log", rr.TextLog(f"{solution.origin} {solution.chain}: {solution.outcome}, {said}", level=level))


def _log_difference(rr: Any, stream: Any, on_board: Solution, ground: Solution) -> None:
    if on_board.quaternion is None or ground.quaternion is None:
        return
    a, b = (matrix_from_quaternion(np.array(s.quaternion, float)) for s in (on_board, ground))
    cross = math.degrees(math.acos(max(-1.0, min(1.0, float(a[2] @ b[2]))))) * 3600
    stream.log("attitude/on_board_minus_ground_arcsec", rr.Scalars(cross))
