"""The active camera of each profile: the documented camera, or a calibration selected for reruns."""

from __future__ import annotations

import contextlib
import threading
from dataclasses import dataclass, replace

from gss.device.table_use import calibrated
from gss.domain.camera_profile import CameraProfile
from gss.domain.errors import BadInput, NotFound, StoreDown
from gss.instruments.registry import Registry
from gss.instruments.telemetry_roles import Quantities
from gss.operations.clock import Now
from gss.operations.events import EventBus
from gss.operations.frames.dark_frames import DARK
from gss.store import choices, studies
from gss.store.engine import Database
from gss.store.models import Calibration

PREFIX = "camera."
SOURCE = "calibration"
"""Key in ``sources`` of a profile whose value names the calibration of its values."""


@dataclass(frozen=True)
class _ActiveCalibration:
    """Calibration selected for a camera. ``dark_key``: key of its dark frame, "" if there is none."""

    id: int
    values: dict[str, float | str]
    dark_key: str

    def applied_to(self, documented: CameraProfile) -> CameraProfile:
        """Return the documented camera with these values. Raises BadInput if the values do not fit this camera."""
        sources = {**documented.sources, SOURCE: f"calibration {self.id}"}
        if self.dark_key:
            sources[DARK] = self.dark_key
        return replace(calibrated(documented, self.values), sources=sources)


@dataclass(frozen=True)
class _ActiveCamera:
    """Camera of a calibration and of the package that was installed when it was built. ``problem``: reason why the
    calibration does not fit this package; the camera is then the documented camera."""

    calibration: _ActiveCalibration
    documented: CameraProfile
    profile: CameraProfile
    problem: BadInput | None


class CameraBook:
    """Provides the active cameras. Changes apply from the next frame on; stored solutions keep their camera.

    A package can be replaced while the server runs, so that the camera is built from the installed package at its use.
    A calibration that does not fit this package is not used, and an event states the reason.
    """

    def __init__(self, database: Database, instruments: Registry, bus: EventBus, now: Now) -> None:
        self._database, self._instruments, self._bus, self._now = database, instruments, bus, now
        self._lock = threading.Lock()
        self._selected: dict[str, _ActiveCalibration] = {}
        self._built: dict[str, _ActiveCamera] = {}
        with database.unit_of_work() as session:
            for choice in choices.read(session, PREFIX):
                name, calibration_id = choice.name.removeprefix(PREFIX), int(choice.value["calibration_id"])
                self._selected[name] = _active(studies.calibration(session, calibration_id))

    def profile(self, name: str) -> CameraProfile:
        """Return the active camera of a profile. Raises NotFound for an unknown name."""
        active = self._active_camera(name)
        return self._instruments.camera(name) if active is None else active.profile

    def quantities_of(self, name: str) -> Quantities:
        """Return the standard quantities in the telemetry of an instrument. Raises NotFound for an unknown name."""
        return self._instruments.get(name).roles.quantities

    def profiles(self) -> dict[str, CameraProfile]:
        """Return all active cameras by name, for workers in other processes."""
        return {name: self.profile(name) for name in self._instruments.cameras()}

    def in_use(self, name: str) -> int | None:
        """Return the id of the active calibration; None for the documented camera."""
        active = self._active_camera(name) if self._instruments.has(name) else None
        return None if active is None or active.problem else active.calibration.id

    def dark_of(self, name: str) -> str:
        """Return the key of the dark frame of the active camera; "" if there is none."""
        return self.profile(name).sources.get(DARK, "")

    def use(self, calibration_id: int, *, user: str) -> None:
        """Use a calibration for its camera from now on. Raises BadInput if it does not fit the installed package."""
        with self._database.unit_of_work() as session:
            row = studies.calibration(session, calibration_id)
            active = _active(row)
            active.applied_to(self._instruments.camera(row.profile))
            choices.write(session, PREFIX + row.profile, {"calibration_id": calibration_id}, self._now(), user)
        with self._lock:
            self._selected[row.profile] = active

    def use_documented(self, name: str) -> None:
        """Use the documented camera again. Raises NotFound if no calibration is active."""
        self._instruments.get(name)
        with self._database.unit_of_work() as session:
            if not choices.forget(session, PREFIX + name):
                raise NotFound("no calibration is active for this camera", got=name)
        with self._lock:
            self._selected.pop(name, None)

    def with_values(self, name: str, values: dict[str, float | str], calibration_id: int) -> CameraProfile:
        """Return the documented camera with the values of a calibration. Its ``sources`` name the calibration."""
        return _ActiveCalibration(calibration_id, values, "").applied_to(self._instruments.camera(name))

    def _active_camera(self, name: str) -> _ActiveCamera | None:
        """Return the camera of the selected calibration; None if no calibration is selected."""
        with self._lock:
            selected = self._selected.get(name)
            if selected is None:
                return None
            documented, built = self._instruments.camera(name), self._built.get(name)
            # The registry returns the same object until the package is replaced.
            if built is not None and built.documented is documented and built.calibration is selected:
                return built
            active = self._built[name] = _built(selected, documented)
        if active.problem is not None:
            text = (
                f"{name}: calibration {selected.id} does not fit the installed package, so that the documented camera"
            )
            # A store that fails must not stop the solver.
            with contextlib.suppress(StoreDown):
                self._bus.record("calibration", "warning", f"{text} is used: {active.problem}")
        return active


def _active(row: Calibration) -> _ActiveCalibration:
    """Return a calibration with the key of the dark frame that it used or contains."""
    dark = row.result.get("dark_frame")
    return _ActiveCalibration(row.id, row.values, dark.get("key", "") if isinstance(dark, dict) else str(dark or ""))


def _built(calibration: _ActiveCalibration, documented: CameraProfile) -> _ActiveCamera:
    try:
        return _ActiveCamera(calibration, documented, calibration.applied_to(documented), None)
    except BadInput as error:
        return _ActiveCamera(calibration, documented, documented, error)
