"""Loading, solving and stacking of frames for studies. The frames come from the store or from files."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from functools import partial
from typing import Any, TypedDict

import numpy as np
from numpy.typing import NDArray

from gss.catalogue_tools.corrections.corrections import aberrate
from gss.domain.camera import Camera
from gss.domain.camera_profile import CameraProfile
from gss.domain.errors import BadInput
from gss.domain.results import SolveResult
from gss.domain.stars import StarTable
from gss.operations.frames.frames import FrameService, Pixels
from gss.operations.frames.observer import Observer, epoch_at, observer_of_frame
from gss.operations.frames.solve import Solver, SolveRequest
from gss.pipeline.calibration.sightings import FrameStars, frame_stars
from gss.pipeline.calibration.trails import trail_px
from gss.store import frames as store
from gss.store.engine import Database

ProgressCallback = Callable[[float, str], None]
"""Function called with the completed share and a text. It can raise an exception to cancel."""


@dataclass(frozen=True)
class Shot:
    """One frame of a night. ``pixels``: function that reads the pixels; ``frame_id``: id in the store, None for a file;
    ``observer``: velocity of the observer; None leaves aberration uncorrected. ``time_known``: False if ``taken`` is the
    time of the import."""

    name: str
    taken: datetime
    exposure_s: float | None
    bits: int
    pixels: Callable[[], Pixels]
    frame_id: int | None = None
    observer: Observer | None = None
    time_known: bool = True

    @property
    def epoch_jyear(self) -> float | None:
        """Epoch of the star positions; None for the epoch of the solver."""
        return epoch_at(self.taken) if self.time_known else None


class ShotAccount(TypedDict):
    """States whether a shot was used. ``reason``: why it was not used."""

    name: str
    used: bool
    reason: str


@dataclass(frozen=True)
class SolvedFrame:
    """The solved shots with their results and stars. ``account``: an entry for every shot, solved or not.

    ``start``: initial camera for a calibration. It is the camera of the profile or, without a profile, the camera of the
    first solved shot.
    """

    shots: list[Shot]
    results: list[SolveResult]
    stars: list[FrameStars]
    start: Camera
    account: list[ShotAccount]


class StoredShots:
    """Loads shots from the store."""

    def __init__(self, database: Database, frames: FrameService) -> None:
        self._database, self._frames = database, frames

    def of(self, ids: Sequence[int], aberration: bool | None = None, *, timed: bool = False) -> list[Shot]:
        """Return the frames with the given ids, oldest first. Raises BadInput if a frame has missing rows, or, with
        ``timed``, an unknown time of exposure.
        ``aberration``: True or False to correct aberration or not. None corrects it in frames with a known time of
        observation, except in simulated frames, because the simulator adds aberration only if this is enabled."""
        with self._database.unit_of_work() as session:
            rows = [store.get(session, i) for i in ids]
        incomplete = [row.id for row in rows if not row.complete]
        if incomplete:
            raise BadInput(
                "incomplete frames cannot be used",
                got=f"frame {incomplete[0]} has missing rows",
                hint="download the missing rows, or exclude the frame",
            )
        untimed = [row.id for row in rows if timed and not row.time_known]
        if untimed:
            raise BadInput(
                "frames with an unknown time of exposure cannot be used",
                expected="frames whose files state their time (DATE-OBS or EXIF)",
                got=f"frame {untimed[0]} has only the time of its import",
                hint="exclude the frame, or import it from a file with a time",
            )
        return [
            Shot(
                f"frame {r.id}",
                r.taken,
                r.exposure_s,
                r.bits,
                partial(self._frames.pixels, r),
                r.id,
                observer_of_frame(r, aberration),
                r.time_known,
            )
            for r in sorted(rows, key=lambda row: (row.taken, row.id))
        ]


def solve_shots(
    solver: Solver,
    shots: Sequence[Shot],
    profile: CameraProfile | None,
    fov_rad: float | None,
    progress: ProgressCallback,
    chain: str = "reference",
    camera: Camera | None = None,
) -> SolvedFrame:
    """Solve shots with a known camera, with a known width of the field of view, or blind. ``camera``: geometry to use
    instead of the geometry in the profile. Raises BadInput if no shot is solved."""
    used: list[tuple[Shot, SolveResult, FrameStars]] = []
    account: list[ShotAccount] = []
    for k, shot in enumerate(shots):
        progress(k / len(shots), f"{shot.name}, {k + 1} of {len(shots)}")
        try:
            picture = shot.pixels()
            result = solver.solve(picture, request_of(shot, profile, fov_rad, chain, camera))
        except BadInput as error:
            account.append({"name": shot.name, "used": False, "reason": str(error)})
            continue
        pixels = picture
        if profile is not None:
            pixels, _ = profile.sensor.dark_columns.split(picture, profile.camera.columns)
        stars = matched_stars(solver, shot, pixels, result, profile)
        account.append({"name": shot.name, "used": stars is not None, "reason": "" if stars else result.reason})
        if stars is not None:
            used.append((shot, result, stars))
    if not used:
        first_reason = account[0]["reason"] if account else "no frame"
        raise BadInput(
            "no frame could be solved",
            expected="at least one frame whose stars can be identified",
            got=first_reason,
            hint="check that the frames were taken with this camera",
        )
    start = profile.camera if profile else used[0][1].camera
    return SolvedFrame([t[0] for t in used], [t[1] for t in used], [t[2] for t in used], start, account)


def stack(shots: Sequence[Shot], profile: CameraProfile) -> NDArray[Any]:
    """Return the (m, rows, columns) pixels of m shots. Raises BadInput if a frame does not have the size of the
    camera."""
    images = []
    for shot in shots:
        image, _ = profile.sensor.dark_columns.split(shot.pixels(), profile.camera.columns)
        if image.shape != (profile.camera.rows, profile.camera.columns):
            raise BadInput(
                f"{shot.name} was taken with another camera",
                expected=f"{profile.camera.columns} x {profile.camera.rows} px",
                got=f"{image.shape[1]} x {image.shape[0]} px",
            )
        images.append(image)
    return np.stack(images)


def request_of(
    shot: Shot, profile: CameraProfile | None, fov_rad: float | None, chain: str, camera: Camera | None = None
) -> SolveRequest:
    """Return the request to solve a shot with a known camera, with a known width of the field of view, or blind.
    ``camera``: geometry to use instead of the geometry in the profile."""
    request = SolveRequest(
        chain=chain, epoch_jyear=shot.epoch_jyear, observer=shot.observer, exposure_s=shot.exposure_s
    )
    if profile is not None:
        return replace(request, camera_profile=profile if camera is None else replace(profile, camera=camera))
    if camera is not None:
        return replace(request, camera=camera)
    return replace(request, fov_rad=fov_rad) if fov_rad is not None else replace(request, blind=True)


def matched_stars(
    solver: Solver, shot: Shot, pixels: Pixels, result: SolveResult, profile: CameraProfile | None
) -> FrameStars | None:
    """Return the identified stars of a shot and the length of their trails; None without a solution."""
    saturation_dn = float(profile.sensor.saturation_dn) if profile else float((1 << shot.bits) - 1)
    trails = trail_px(pixels, result.centroids, saturation_dn) if result.attitude is not None else 0.0
    return frame_stars(
        shot.name,
        result,
        apparent_stars(solver, shot),
        exposure_s=math.nan if shot.exposure_s is None else shot.exposure_s,
        time_s=shot.taken.timestamp(),
        streak_px=trails,
        saturation_dn=saturation_dn,
        pixels=pixels,
    )


def apparent_stars(solver: Solver, shot: Shot) -> StarTable:
    """Return the stars at the date of a shot, displaced by aberration. Aberration changes the image scale by up to
    1e-4, which would otherwise appear as an error of the fitted focal length."""
    stars = solver.stars(shot.epoch_jyear)
    if shot.observer is None:
        return stars
    return replace(stars, icrs=aberrate(stars.icrs, np.array(shot.observer.velocity_c)))
