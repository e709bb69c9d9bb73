"""Writes frames, attitudes, telemetry, commands and events to a Rerun recording, which is read in pieces."""

from __future__ import annotations

import io
import math
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from datetime import datetime
from typing import Any

import numpy as np
from PIL import Image

from gss.domain.angles import Array
from gss.domain.camera_record import camera_from
from gss.domain.frames import pointing_difference_rad
from gss.domain.rotation import matrix_from_quaternion
from gss.domain.stars import StarTable
from gss.operations.frames import pictures
from gss.operations.frames.frame_detail import FrameDetail
from gss.operations.frames.frames import Pixels
from gss.operations.frames.overlay import PredictedStar, StarOverlay
from gss.operations.frames.place import Place
from gss.operations.frames.sky import bodies
from gss.operations.recordings.blueprints import Use, blueprint
from gss.operations.recordings.lanes import Lanes
from gss.store.models import Command, Event, Frame, Solution

JPEG_QUALITY = 80
SPHERE_RADIUS = 10.0
EARTH_RADIUS = 1.6
EARTH_RADIUS_KM = 6378.137
SKY_MAG = 4.5
PATH_STEP = math.radians(1) * EARTH_RADIUS
"""Smallest distance between points of the path. Every new point writes the path again."""
MAX_PATH = 400
"""Largest number of points of the path: about one revolution in low orbit."""
GREEN, BLUE, ORANGE, WHITE, GREY = (95, 211, 166), (91, 183, 240), (244, 149, 63), (255, 255, 255), (133, 145, 160)
AXES = [(245, 102, 111), (79, 181, 141), BLUE]
LEVELS = {"ok": "INFO", "watch": "WARN", "warning": "WARN", "critical": "ERROR"}
ARCSEC = 3600 * 180 / math.pi
PlaceAt = Callable[[datetime], Place | None]


class Recorder:
    """One recording on the timelines ``frame`` (the frame's id in the store) and ``utc``. Not thread-safe."""

    def __init__(self, recording_id: str, use: Use, stars: StarTable, place_at: PlaceAt) -> None:
        import rerun as rr  # imported here because the import takes 0.5 s and 100 MB

        self._rr, self._place_at = rr, place_at
        self._stream = rr.RecordingStream("gss", recording_id=recording_id[:120], send_properties=True)
        self._stream.set_log_time_enabled(False)  # viewers do not need the time of writing
        self._memory = self._stream.binary_stream()
        self._stream.send_blueprint(blueprint(use), make_active=True, make_default=True)
        self._path: deque[Array] = deque(maxlen=MAX_PATH)
        self._frame_id: int | None = None
        self._lanes = Lanes(self._state)
        self._sky(stars)

    def take(self) -> bytes:
        """Return the data written since the last call as a complete .rrd. The first piece contains the layout and the
        sky."""
        return bytes(self._memory.read(flush=True) or b"")

    # --- content --------------------------------------------------------------------------------------------------

    def frame(self, detail: FrameDetail, pixels: Pixels | None, marks: bool = True) -> None:
        """Add a frame with its solutions. ``pixels``: None omits the picture; ``marks``: false omits the marks of stars
        and regions, which would be drawn over the picture of an earlier frame."""
        self._at(detail.frame.taken, detail.frame.id)
        if pixels is not None:
            self._picture(pixels, pictures.full_scale_dn(detail.frame))
        best = detail.ground or detail.on_board
        if best is not None and marks:
            self._overlays(best)
        if best is not None and best.quaternion is not None:
            self._camera(best, detail.frame.taken)
        for solution in detail.solutions:
            self._summary(solution)
        self._figures(detail)

    def telemetry(self, received: datetime, values: Mapping[str, Any]) -> None:
        """Add the numbers and states of one packet, by standard quantity."""
        self._lanes.telemetry(received, values)
        self._at(received)
        for name, value in values.items():
            if isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value):
                self._stream.log(f"telemetry/{name}", self._rr.Scalars(float(value)))

    def command(self, row: Command) -> None:
        """Add a command with its stages and its current result."""
        self._lanes.command(row)
        self._at(row.finished or row.created)
        arguments = ", ".join(f"{k} {v}" for k, v in row.arguments.items())
        level = "ERROR" if row.result in ("rejected", "failed", "unknown") else "INFO"
        message = f"{row.name} {arguments}".strip() + f": {row.result}" + (f", {row.detail}" if row.detail else "")
        self._stream.log("log/commands", self._rr.TextLog(message, level=level))

    def event(self, row: Event) -> None:
        """Add a recorded event."""
        self._at(row.at)
        self._stream.log("log/events", self._rr.TextLog(row.text, level=LEVELS.get(row.severity, "INFO")))

    # --- drawing --------------------------------------------------------------------------------------------------

    def _at(self, moment: datetime, frame_id: int | None = None) -> None:
        """Set the time of the following entries. Entries without a frame are assigned to the previous frame and
        therefore appear on both timelines."""
        self._frame_id = frame_id if frame_id is not None else self._frame_id
        self._stream.reset_time()
        if self._frame_id is not None:
            self._stream.set_time("frame", sequence=self._frame_id)
        self._stream.set_time("utc", timestamp=moment)

    def _state(self, moment: datetime, path: str, state: str | None) -> None:
        """Write the state of a lane; None ends it."""
        import pyarrow as pa  # imported late like rerun, which imports pyarrow

        self._at(moment)
        self._stream.log(path, self._rr.StateChange(state=pa.array([state], pa.string())))

    def _sky(self, stars: StarTable) -> None:
        rr, bright = self._rr, stars.brighter_than(SKY_MAG)
        radii = np.clip(0.06 * 10 ** (-0.12 * bright.v_mag), 0.01, 0.12)
        labels = [bright.name_of(int(h)) for h in bright.hip]
        points = rr.Points3D(bright.icrs * SPHERE_RADIUS, radii=radii, colors=WHITE, labels=labels, show_labels=False)
        self._stream.log("sky/stars", points, static=True)
        circles = [_parallel(d) for d in (-60, -30, 0, 30, 60)]
        self._stream.log("sky/grid", rr.LineStrips3D(circles, colors=(48, 59, 71), radii=0.005), static=True)
        self._stream.log("sky", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)

    def _picture(self, pixels: Pixels, full_dn: float | None) -> None:
        buffer = io.BytesIO()
        grey = pictures.apply(pixels, pictures.auto_stretch(pixels, full_dn))
        Image.fromarray(grey).save(buffer, format="JPEG", quality=JPEG_QUALITY)
        self._stream.log("camera/image", self._rr.EncodedImage(contents=buffer.getvalue(), media_type="image/jpeg"))

    def _overlays(self, solution: Solution) -> None:
        detail = solution.detail
        rejected = [r for r in detail["regions"] if r["rejected"]]
        corners = np.array([[r["col_min"], r["row_min"]] for r in rejected], float).reshape(-1, 2)
        ends = np.array([[r["col_max"] + 1, r["row_max"] + 1] for r in rejected], float).reshape(-1, 2)
        reasons = [r["rejected"] for r in rejected]
        boxes = self._rr.Boxes2D(mins=corners, sizes=ends - corners, colors=ORANGE, labels=reasons, show_labels=False)
        self._stream.log("camera/image/rejected", boxes)
        self._points("camera/image/centroids", detail["stars"], WHITE, 1.0)
        self._points("camera/image/matched", [s for s in detail["stars"] if s.get("hip")], GREEN, 6.0)
        self._points("camera/image/predicted", detail["predicted"], BLUE, 3.0)

    def _points(
        self, path: str, rows: Sequence[StarOverlay | PredictedStar], colour: tuple[int, int, int], radius: float
    ) -> None:
        # Rerun counts pixels from the corner, GSS from the centre. An empty list removes the marks of the previous
        # frame.
        positions = np.array([[row["col_px"] + 0.5, row["row_px"] + 0.5] for row in rows], float).reshape(-1, 2)
        labels = [f"{r['name']} {r['v_mag']:.2f}" if r.get("name") and r.get("v_mag") is not None else "" for r in rows]
        self._stream.log(
            path, self._rr.Points2D(positions, colors=colour, radii=radius, labels=labels, show_labels=False)
        )

    def _camera(self, solution: Solution, taken_at: datetime) -> None:
        rr, cam_from_icrs = self._rr, matrix_from_quaternion(np.array(solution.quaternion, float))
        position = self._place_at(taken_at)
        eye = np.zeros(3) if position is None else position.km / EARTH_RADIUS_KM * EARTH_RADIUS
        camera = camera_from(solution.camera)
        outline = camera.outline(12) @ cam_from_icrs * SPHERE_RADIUS
        rays = [np.stack([eye, corner @ cam_from_icrs * SPHERE_RADIUS]) for corner in camera.corners()]
        self._stream.log(
            "sky/field", rr.LineStrips3D([np.vstack([outline, outline[:1]]), *rays], colors=BLUE, radii=0.02)
        )
        axes = rr.Arrows3D(origins=[eye] * 3, vectors=[cam_from_icrs[k] * 2.0 for k in range(3)], colors=AXES)
        self._stream.log("sky/body_axes", axes)
        sky_bodies = bodies(taken_at)
        positions, names = [b.icrs * SPHERE_RADIUS for b in sky_bodies], [b.name for b in sky_bodies]
        self._stream.log("sky/bodies", rr.Points3D(positions, radii=0.18, colors=[(227, 197, 76), GREY], labels=names))
        if position is None:
            return
        self._stream.log(
            "sky/orbit/position",
            rr.Points3D([eye], radii=0.08, colors=WHITE, labels=[position.source], show_labels=False),
        )
        if not self._path or np.linalg.norm(eye - self._path[-1]) > PATH_STEP:
            self._path.append(eye)
            self._stream.log("sky/orbit/path", rr.LineStrips3D([np.array(self._path)], colors=BLUE, radii=0.01))
        ball = rr.Ellipsoids3D(half_sizes=[[EARTH_RADIUS] * 3], colors=(39, 80, 110), fill_mode="solid")
        self._stream.log("sky/earth", ball)

    def _summary(self, solution: Solution) -> None:
        solved = solution.outcome == "solved"
        text = f"{solution.matched} of {solution.found} stars" if solved else solution.reason
        message = f"{solution.origin} {solution.chain}: {solution.outcome}, {text}"
        self._stream.log("log/solutions", self._rr.TextLog(message, level="INFO" if solved else "WARN"))

    def _figures(self, detail: FrameDetail) -> None:
        """Plot the matched stars, error and residual of each chain, and the difference of the on-board and ground
        attitudes."""
        scalars = self._rr.Scalars
        for solution in reversed(detail.solutions):
            name = "on_board" if solution.origin == "on board" else solution.chain
            self._stream.log(f"stars/{name}/matched", scalars(float(solution.matched)))
            error = solution.error_axis_rad
            if error is not None and solution.outcome == "solved":
                self._stream.log(f"attitude/{name}/error_arcsec", scalars(error * ARCSEC))
            rms = residual_rms_arcsec(solution)
            if rms is not None:
                self._stream.log(f"attitude/{name}/residual_rms_arcsec", scalars(rms))
        on_board, ground = detail.on_board, detail.ground
        if (
            on_board is not None
            and ground is not None
            and on_board.quaternion is not None
            and ground.quaternion is not None
        ):
            first, second = (matrix_from_quaternion(np.array(s.quaternion, float)) for s in (on_board, ground))
            cross = pointing_difference_rad(first, second)[0] * ARCSEC
            self._stream.log("attitude/on_board_minus_ground_arcsec", scalars(cross))


def residual_rms_arcsec(solution: Solution) -> float | None:
    """Return the root mean square of the stars' residuals; None if no star has a residual."""
    residuals = [
        (s["dx_arcsec"], s["dy_arcsec"]) for s in solution.detail.get("stars", ()) if s.get("dx_arcsec") is not None
    ]
    return float(np.sqrt(np.mean(np.square(np.hypot(*np.array(residuals).T))))) if residuals else None


def _parallel(dec_deg: float) -> Array:
    ra, dec = np.linspace(0, 2 * np.pi, 73), math.radians(dec_deg)
    return SPHERE_RADIUS * np.stack(
        [np.cos(dec) * np.cos(ra), np.cos(dec) * np.sin(ra), np.full_like(ra, np.sin(dec))], axis=-1
    )


def pixels_of(frame: Frame, read: Callable[[Frame], Pixels]) -> Pixels | None:
    """Return the pixels of a frame; None if retention removed them."""
    return None if frame.pixels_removed is not None else read(frame)
