"""The cameras that the ground uses for each profile: the documented one, or a calibration chosen for reruns."""

from __future__ import annotations

import threading
from dataclasses import replace

from gss.device.table_use import calibrated
from gss.domain.errors import NotFound
from gss.domain.profiles import PROFILES, CameraProfile, profile
from gss.operations.clock import Now
from gss.operations.studies.dark_frames import DARK
from gss.store import choices, studies
from gss.store.engine import Database
from gss.store.models import Calibration

PREFIX = "camera."
SOURCE = "calibration"
"""Key in a profile's ``sources`` that names the calibration it comes from."""


class CameraBook:
    """The cameras in use. Changes take effect with the next frame; stored solutions keep their camera."""

    def __init__(self, database: Database, now: Now) -> None:
        self._database, self._now = database, now
        self._lock = threading.Lock()
        self._used: dict[str, tuple[int, CameraProfile]] = {}
        with database.unit_of_work() as session:
            for choice in choices.read(session, PREFIX):
                name, calibration_id = choice.name.removeprefix(PREFIX), int(choice.value["calibration_id"])
                row = studies.calibration(session, calibration_id)
                self._used[name] = calibration_id, _camera_of(row)

    def profile(self, name: str) -> CameraProfile:
        """Return the camera in use for a profile. Raises NotFound for an unknown name."""
        with self._lock:
            used = self._used.get(name)
        return profile(name) if used is None else used[1]

    def profiles(self) -> dict[str, CameraProfile]:
        """Return every camera, for workers in other processes."""
        return {name: self.profile(name) for name in PROFILES}

    def in_use(self, name: str) -> int | None:
        """Return the id of the calibration in use; None for the documented camera."""
        with self._lock:
            used = self._used.get(name)
        return None if used is None else used[0]

    def dark_of(self, name: str) -> str:
        """Return the key of the dark frame in use with the camera; "" if there is none."""
        return self.profile(name).sources.get(DARK, "")

    def use(self, calibration_id: int, *, user: str) -> None:
        """Use this calibration for its camera from now on."""
        with self._database.unit_of_work() as session:
            row = studies.calibration(session, calibration_id)
            camera = _camera_of(row)
            choices.write(session, PREFIX + row.profile, {"calibration_id": calibration_id}, self._now(), user)
        with self._lock:
            self._used[row.profile] = calibration_id, camera

    def use_documented(self, name: str) -> None:
        """Use the documented camera again. Raises NotFound if no calibration is in use."""
        profile(name)
        with self._database.unit_of_work() as session:
            if not choices.forget(session, PREFIX + name):
                raise NotFound("no calibration is in use for this camera", got=name)
        with self._lock:
            self._used.pop(name, None)


def with_values(name: str, values: dict[str, float | str], calibration_id: int) -> CameraProfile:
    """Return the documented camera with the values of a calibration, naming the calibration in ``sources``."""
    camera = calibrated(profile(name), values)
    return replace(camera, sources={**camera.sources, SOURCE: f"calibration {calibration_id}"})


def _camera_of(row: Calibration) -> CameraProfile:
    """Return the camera of a calibration, with the dark frame that it used or contains."""
    camera = with_values(row.profile, row.values, row.id)
    dark = row.result.get("dark_frame")
    key = dark.get("key", "") if isinstance(dark, dict) else str(dark or "")
    return replace(camera, sources={**camera.sources, DARK: key}) if key else camera
