"""The active camera of each profile: the documented camera, or a calibration selected for reruns."""

from __future__ import annotations

import threading
from dataclasses import replace

from gss.device.table_use import calibrated
from gss.domain.camera_profile import CameraProfile
from gss.domain.errors import NotFound
from gss.instruments.registry import Registry
from gss.instruments.telemetry_roles import Quantities
from gss.operations.clock import Now
from gss.operations.frames.dark_frames import DARK
from gss.store import choices, studies
from gss.store.engine import Database
from gss.store.models import Calibration

PREFIX = "camera."
SOURCE = "calibration"
"""Key in ``sources`` of a profile whose value names the calibration of its values."""


class CameraBook:
    """Provides the active cameras. Changes apply from the next frame on; stored solutions keep their camera."""

    def __init__(self, database: Database, instruments: Registry, now: Now) -> None:
        self._database, self._instruments, self._now = database, instruments, now
        self._lock = threading.Lock()
        self._used: dict[str, tuple[int, CameraProfile]] = {}
        with database.unit_of_work() as session:
            for choice in choices.read(session, PREFIX):
                name, calibration_id = choice.name.removeprefix(PREFIX), int(choice.value["calibration_id"])
                row = studies.calibration(session, calibration_id)
                if instruments.has(name):
                    self._used[name] = calibration_id, self._camera_of(row)

    def profile(self, name: str) -> CameraProfile:
        """Return the active camera of a profile. Raises NotFound for an unknown name."""
        with self._lock:
            active = self._used.get(name)
        return self._instruments.camera(name) if active is None else active[1]

    def quantities_of(self, name: str) -> Quantities:
        """Return the standard quantities in the telemetry of an instrument. Raises NotFound for an unknown name."""
        return self._instruments.get(name).roles.quantities

    def profiles(self) -> dict[str, CameraProfile]:
        """Return all active cameras by name, for workers in other processes."""
        return {name: self.profile(name) for name in self._instruments.cameras()}

    def in_use(self, name: str) -> int | None:
        """Return the id of the active calibration; None for the documented camera."""
        with self._lock:
            active = self._used.get(name)
        return None if active is None else active[0]

    def dark_of(self, name: str) -> str:
        """Return the key of the dark frame of the active camera; "" if there is none."""
        return self.profile(name).sources.get(DARK, "")

    def use(self, calibration_id: int, *, user: str) -> None:
        """Use a calibration for its camera from now on."""
        with self._database.unit_of_work() as session:
            row = studies.calibration(session, calibration_id)
            camera = self._camera_of(row)
            choices.write(session, PREFIX + row.profile, {"calibration_id": calibration_id}, self._now(), user)
        with self._lock:
            self._used[row.profile] = calibration_id, camera

    def use_documented(self, name: str) -> None:
        """Use the documented camera again. Raises NotFound if no calibration is active."""
        self._instruments.get(name)
        with self._database.unit_of_work() as session:
            if not choices.forget(session, PREFIX + name):
                raise NotFound("no calibration is active for this camera", got=name)
        with self._lock:
            self._used.pop(name, None)

    def with_values(self, name: str, values: dict[str, float | str], calibration_id: int) -> CameraProfile:
        """Return the documented camera with the values of a calibration. Its ``sources`` name the calibration."""
        camera = calibrated(self._instruments.camera(name), values)
        return replace(camera, sources={**camera.sources, SOURCE: f"calibration {calibration_id}"})

    def _camera_of(self, row: Calibration) -> CameraProfile:
        """Return the camera of a calibration, with the dark frame that the calibration used or contains."""
        camera = self.with_values(row.profile, row.values, row.id)
        dark = row.result.get("dark_frame")
        key = dark.get("key", "") if isinstance(dark, dict) else str(dark or "")
        return replace(camera, sources={**camera.sources, DARK: key}) if key else camera
