"""Frame service: stores frames with their pixels, solves them on the ground, and stores the sensor's own results."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from datetime import datetime, timedelta
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gss.domain.camera_profile import CameraProfile
from gss.domain.dark_columns import NO_DARK_COLUMNS, DarkColumns
from gss.domain.errors import BadInput, GssError, NotFound
from gss.domain.results import SolveResult
from gss.domain.stars import StarTable
from gss.instruments.registry import Registry
from gss.operations.clock import Now
from gss.operations.events import EventBus
from gss.operations.frames.frame_detail import FrameDetail
from gss.operations.frames.frame_files import ImportedFrame, read_frame
from gss.operations.frames.frame_values import dark_columns_of, frame_values
from gss.operations.frames.observer import epoch_of_frame, observer_of_frame
from gss.operations.frames.onboard_reported import reported_of
from gss.operations.frames.onboard_results import OnboardRecord, onboard_result
from gss.operations.frames.solution_rows import solution_row, with_overlays
from gss.operations.frames.solve import Solver, SolveRequest, warm_up_image
from gss.operations.frames.solve_queue import SolveQueue
from gss.operations.parsing.parse_processes import ParseProcesses
from gss.pipeline.chains.systems import on_board
from gss.store import frames as store
from gss.store.blobs import BlobStore
from gss.store.engine import Database
from gss.store.models import Frame, Solution

Pixels = NDArray[np.generic]
SOLVES_AT_ONCE = 2
SAME_FRAME = timedelta(minutes=1)
"""Maximum difference between two times of the same frame, which can be from different clock correlations."""


class FrameService:
    """Stores frames and runs chains on them. A separate thread solves new frames in order of arrival.

    ``check_room``: raises StoreDown if the disk is too full. Its argument names the operation.
    """

    def __init__(
        self,
        database: Database,
        blobs: BlobStore,
        bus: EventBus,
        solver: Solver,
        stars: StarTable,
        now: Now,
        chain: str,
        parsing: ParseProcesses,
        check_room: Callable[[str], None],
        instruments: Registry,
    ) -> None:
        self._check_room, self._instruments = check_room, instruments
        self._database, self._blobs, self._bus, self._now = database, blobs, bus, now
        self._solver, self._stars, self._chain, self._parsing = solver, stars, chain, parsing
        self.queue = SolveQueue(self._solve_on_arrival, bus)
        # The number of concurrent solutions is limited, because the solver's tables need much memory.
        self._few_solves = threading.BoundedSemaphore(SOLVES_AT_ONCE)

    def attitude_pairs(self, limit: int) -> list[tuple[Frame, Solution, Solution]]:
        """Return the latest frames of the device whose on-board and ground solutions both have an attitude, with these
        solutions."""
        with self._database.unit_of_work() as session:
            return store.attitude_pairs(session, limit)

    def stop(self) -> None:
        """Finish the current solution and drop the waiting frames. A user can solve them later."""
        self.queue.stop()

    def warm(self, profile_name: str) -> None:
        """Build the tables and compile the loops before the first real frame, by solving a synthetic frame in the background."""
        self.queue.submit(lambda: self._warm(profile_name))

    def _warm(self, profile_name: str) -> None:
        profile = self._instruments.camera(profile_name)
        image = warm_up_image(profile)
        for chain in dict.fromkeys((self._chain, on_board(profile).name)):
            try:
                request = SolveRequest(chain=chain, profile=profile_name, exposure_s=profile.sensor.exposure_s)
                self._solver.solve(image, request)
            except Exception as error:  # after a failure, only the first frame is slower
                self._bus.record("solution", "warning", f"The {chain} chain could not run: {error}")

    def add_from_device(self, pixels: Pixels, values: Mapping[str, Any]) -> Frame:
        """Store a downlinked frame and queue it for solving. ``values``: columns of its row."""
        frame, pixels = self._add(pixels, source="device", **values)
        missing = "" if frame.complete else ", rows are missing"
        self._bus.record(
            "frame", "ok", f"Frame {frame.id} stored, no. {frame.number} on board{missing}", frame_id=frame.id
        )
        if frame.complete and frame.profile is not None:  # a thumbnail has no profile and cannot be solved
            self.queue.add(frame, pixels)
        return frame

    def add_from_file(self, data: bytes, name: str, profile_name: str | None, *, user: str) -> Frame:
        """Import a FITS, PNG, TIFF or JPEG file and queue it for solving. Raises BadInput that names the defect."""
        if profile_name:
            self._instruments.camera(profile_name)
        self._check_room("an import")
        name = "".join(c if c.isprintable() else "\N{REPLACEMENT CHARACTER}" for c in name)
        imported = self.read_image(data, name)
        frame, pixels = self._add(
            imported.pixels,
            source="import",
            name=name[:200],
            taken=imported.taken_at or self._now(),
            time_known=imported.taken_at is not None,
            bits=imported.bits,
            exposure_s=imported.exposure_s,
            profile=profile_name or None,
            parameters={"file": imported.source},
        )
        self._bus.record("frame", "ok", f"{name} imported as frame {frame.id} by {user}", frame_id=frame.id)
        self.queue.add(frame, pixels)
        return frame

    def read_image(self, data: bytes, name: str) -> ImportedFrame:
        """Read an image file in a child process. Raises BadInput that names the defect."""
        return self._parsing.parse(read_frame, data, name, classes=(ImportedFrame,), subject=name)

    def has_number(self, number: int, taken: datetime) -> bool:
        """True if a frame of the sensor with this number is stored and was taken within ``SAME_FRAME`` of ``taken``.
        The time is compared because another frame can have the same number if the sensor's clock was set back."""
        with self._database.unit_of_work() as session:
            return store.has_number(session, number, taken - SAME_FRAME, taken + SAME_FRAME)

    def _add(self, pixels: Pixels, **values: Any) -> tuple[Frame, Pixels]:
        """Store the pixels and the row of a frame. Return the row, and the pixels in the form that :meth:`picture` returns."""
        little = np.ascontiguousarray(pixels, pixels.dtype.newbyteorder("<"))
        byte_view = little.data.cast("B")  # avoids another copy of a large frame's bytes
        key = self._blobs.put(byte_view, little.itemsize)
        documented = self._instruments.find_camera(values.get("profile"))
        row: dict[str, object] = {"received": self._now(), "name": "", "complete": True, "sha256": key}
        row |= frame_values(little, documented, values)
        row["stored_bytes"] = self._blobs.size(key)
        row["instrument_version"] = self._instruments.version_of(values.get("profile"))
        with self._database.unit_of_work() as session:
            frame = store.add(session, Frame(**row))
        if not self._blobs.exists(key):  # retention can have removed the same bytes of an older frame in the meantime
            self._blobs.put(byte_view, little.itemsize)
        self._bus.publish("frame", frame)
        little = little.view()
        little.flags.writeable = False
        return frame, little

    def get(self, frame_id: int) -> Frame:
        """Return the frame with that id. Raises NotFound."""
        with self._database.unit_of_work() as session:
            return store.get(session, frame_id)

    def latest_id(self) -> int:
        """Return the id of the latest frame. Raises NotFound if there is none."""
        with self._database.unit_of_work() as session:
            frame = store.latest(session)
        if frame is None:
            raise NotFound("no frame stored yet", hint="take an image or import one")
        return frame.id

    def newest_in_slot(self, slot: int, bits: int) -> Frame | None:
        """Return the latest stored image from a slot of image memory, None if there is none. Meanwhile the slot can
        contain another image."""
        with self._database.unit_of_work() as session:
            return store.newest_in_slot(session, slot, bits)

    def dark_columns(self, profile_name: str) -> DarkColumns:
        """Return the dark columns of a documented camera; none for an unknown camera."""
        profile = self._instruments.find_camera(profile_name)
        return profile.sensor.dark_columns if profile else NO_DARK_COLUMNS

    def pixels(self, frame: Frame) -> Pixels:
        """Return the light-sensitive pixels of a frame as a (rows, columns) array. Raises NotFound if retention removed
        them."""
        return dark_columns_of(frame).split(self.picture(frame), frame.columns)[0]

    def picture(self, frame: Frame) -> Pixels:
        """Return the complete rows of a frame, with the dark columns if the frame has any. Raises NotFound if retention removed
        its pixels."""
        if frame.pixels_removed is not None:
            raise NotFound(
                "the pixels of this frame were removed; its metadata and solutions are kept",
                got=f"removed by retention on {frame.pixels_removed:%Y-%m-%d %H:%M} UTC",
                hint="to view them, restore an earlier backup into another folder",
            )
        data = np.frombuffer(self._blobs.get(frame.sha256), np.dtype(frame.dtype))
        return data.reshape(frame.rows, frame.columns + dark_columns_of(frame).count)

    def page(self, limit: int, offset: int, **filters: Any) -> tuple[int, list[tuple[Frame, Solution | None]]]:
        """Return the total number of frames, and one page of frames with their operational ground solutions."""
        with self._database.unit_of_work() as session:
            total, frames = store.page(session, limit, offset, **filters)
            solutions = store.operational_solutions(session, [f.id for f in frames])
        return total, [(frame, solutions.get(frame.id)) for frame in frames]

    def modes(self) -> list[str]:
        """Return the modes in which the stored frames were taken."""
        with self._database.unit_of_work() as session:
            return store.modes(session)

    def with_solution(self, frame: Frame) -> tuple[Frame, Solution | None]:
        """Return a frame with its operational ground solution."""
        with self._database.unit_of_work() as session:
            return frame, store.operational_solutions(session, [frame.id]).get(frame.id)

    def detail(self, frame_id: int, *, overlays: bool = True) -> FrameDetail:
        """Return a frame with all its solutions, with or without computed overlays. Raises NotFound."""
        with self._database.unit_of_work() as session:
            frame = store.get(session, frame_id)
            solutions = store.solutions_of(session, frame_id)
            same_as = store.earlier_with_content(session, frame)
        on_board = next((s for s in solutions if s.origin == "on board"), None)
        ground = next((s for s in solutions if s.operational), None)
        for row in solutions if overlays else ():
            self._add_overlays(frame, row)
        return FrameDetail(frame, solutions, on_board, ground, same_as)

    def solution(self, solution_id: int) -> Solution:
        """Return the solution with that id. Raises NotFound."""
        with self._database.unit_of_work() as session:
            row = store.get_solution(session, solution_id)
            frame = store.get(session, row.frame_id)
        self._add_overlays(frame, row)
        return row

    def solve(self, frame_id: int, request: SolveRequest) -> Solution:
        """Run a chain on a stored frame, store the result and return it with its overlays. The result becomes the operational
        solution if the frame has none and the result is from the configured chain with the frame's camera."""
        frame = self.get(frame_id)
        return self.solution(self._solve(frame, self.picture(frame), request).id)

    def preview(self, frame_id: int, request: SolveRequest) -> Solution:
        """Run a chain on a stored frame and return the result with its overlays, without storing it. Its id is 0."""
        frame = self.get(frame_id)
        row = self._solved(frame, self.picture(frame), request)
        row.id, row.operational = 0, False
        self._add_overlays(frame, row)
        return row

    def _solve(self, frame: Frame, pixels: Pixels, request: SolveRequest) -> Solution:
        return self._store(self._solved(frame, pixels, request))

    def _solved(self, frame: Frame, pixels: Pixels, request: SolveRequest) -> Solution:
        with self._few_solves:
            result = self._solver.solve(pixels, request)
        return self._row(frame, result, "ground", request.camera_name)

    def pin(self, frame_id: int, solution_id: int, *, user: str) -> Solution:
        """Make a ground solution the operational solution of its frame. Raises BadInput if it is not eligible."""
        with self._database.unit_of_work() as session:
            row = store.get_solution(session, solution_id)
            before = store.operational_solutions(session, [frame_id]).get(frame_id)
        if row.frame_id != frame_id or row.origin != "ground" or row.replay is not None or not row.camera:
            raise BadInput(
                "this solution cannot be the operational result",
                expected=f"a ground solution of frame {frame_id} that is not a rerun of the sensor's own chain",
                got=f"solution {row.id} of frame {row.frame_id}, {row.origin}, chain {row.chain}",
            )
        with self._database.unit_of_work() as session:
            store.pin(session, frame_id, solution_id)
        old = "none" if before is None else f"solution {before.id}, chain {before.chain}"
        text = (
            f"Frame {frame_id}: operational ground result is solution {row.id}, chain {row.chain}; was {old}; by {user}"
        )
        self._bus.record("solution", "watch", text, frame_id=frame_id, solution_id=row.id)
        row = self.solution(solution_id)
        self._bus.publish("solution", row)
        return row

    def _solve_on_arrival(self, frame: Frame, stored_pixels: Pixels | None) -> None:
        frame_id = frame.id
        try:
            pixels = self.picture(frame) if stored_pixels is None else stored_pixels
            request = SolveRequest(
                chain=self._chain,
                profile=frame.profile,
                blind=frame.profile is None,
                epoch_jyear=epoch_of_frame(frame),
                observer=observer_of_frame(frame),
                exposure_s=frame.exposure_s,
            )
            self._solve(frame, pixels, request)
        except GssError as error:
            self._bus.record("solution", "warning", f"Frame {frame_id} was not solved: {error}", frame_id=frame_id)
        except Exception as error:  # the thread must survive, and a defect is reported as an event
            text = f"Frame {frame_id}: internal error of the solver: {type(error).__name__}: {error}"
            self._bus.record("solution", "critical", text, frame_id=frame_id)

    def add_on_board(self, frame: Frame, record: OnboardRecord) -> Solution:
        """Store the sensor's own result for a frame. It replaces an earlier, less complete result."""
        if frame.profile is None:
            raise GssError("the camera of the frame is unknown", expected="a frame of a known instrument")
        profile = self._instruments.camera(frame.profile)
        result = onboard_result(record, profile.camera, on_board(profile).name)
        row = self._row(frame, result, "on board", profile.name)
        row.detail = row.detail | {"reported": reported_of(record, frame)}
        return self._store(row, replaces="on board")

    def set_replay(self, solution_id: int, text: str) -> Solution:
        """Store the text that compares the ground's rerun of the sensor's chain with an on-board solution."""
        with self._database.unit_of_work() as session:
            solution = store.get_solution(session, solution_id)
            solution.replay = text
        self._bus.publish("solution", solution)
        return solution

    def keep_replay(self, frame: Frame, result: SolveResult, text: str) -> Solution:
        """Store the result of the ground's rerun of the sensor's chain, with the text of the comparison."""
        row = self._row(frame, result, "ground", frame.profile or "")
        row.replay = text
        return self._store(row)

    def _row(self, frame: Frame, result: SolveResult, origin: str, camera_name: str) -> Solution:
        profile = self._documented(frame)
        return solution_row(frame, profile, result, self._stars, origin, self._now(), camera_name)

    def _add_overlays(self, frame: Frame, row: Solution) -> None:
        taken = frame.taken if frame.time_known else None
        row.detail = with_overlays(row, self._stars, self._documented(frame), taken)

    def _documented(self, frame: Frame) -> CameraProfile | None:
        """Return the documented camera of a frame, None for an unknown camera."""
        return self._instruments.find_camera(frame.profile)

    def _store(self, row: Solution, replaces: str = "") -> Solution:
        """Store a solution. It replaces the newest solution of the origin ``replaces``, in the same transaction."""
        with self._database.unit_of_work() as session:
            old = store.newest_solution(session, row.frame_id, replaces) if replaces else None
            if old is not None:
                session.delete(old)
            store.add_solution(session, row)
            store.pin_missing(session, [row.frame_id], self._chain)
        self._bus.publish("solution", row)
        return row
