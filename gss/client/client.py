"""Client of one GSS server."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from gss.client.connection import ServerConnection
from gss.client.errors import CommandFailed, JobFailed, ProcedureFailed, TimedOut, TransferFailed
from gss.client.records import (
    Command,
    Event,
    Frame,
    Job,
    Json,
    Packet,
    Procedure,
    ProcedureRun,
    Solution,
    Star,
    TelemetryValue,
    Transfer,
)

POLL_S = 0.25
PAGE = 500
EARLIEST, LATEST = "1970-01-01T00:00:00Z", "2200-01-01T00:00:00Z"
"""Time range that contains every event, used to request the newest event."""
Value = float | int | str | bool
T = TypeVar("T")
Ended = TypeVar("Ended", Command, Transfer, Job)


class Client:
    """Client of one GSS server, signed in with an API token.

    ``address``: for example ``http://localhost:8181``; default: the environment variable GSS_ADDRESS. ``token``: an API
    token; default: GSS_TOKEN. ``reconnect_s``: seconds for which read requests are retried while the server is
    unreachable. Requests that change something are sent only once, because the server may already have executed a
    request whose response was lost; they raise ServerAway.
    """

    def __init__(
        self, address: str = "", token: str = "", *, timeout_s: float = 30.0, reconnect_s: float = 60.0
    ) -> None:
        address = address or os.environ.get("GSS_ADDRESS", "http://localhost:8181")
        self._server = ServerConnection(address, token or os.environ.get("GSS_TOKEN", ""), timeout_s, reconnect_s)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the connections to the server."""
        self._server.close()

    # -- link and authority

    def link(self) -> Mapping[str, Json]:
        """Return the state of the link to the sensor, in the format of ``GET /api/link``."""
        state: Mapping[str, Json] = self._server.get("/link")
        return state

    def wait_connected(self, timeout_s: float = 30.0) -> Mapping[str, Json]:
        """Wait until the sensor responds. Raises TimedOut if it does not."""
        return self._wait(
            "the sensor to respond", lambda: status if (status := self.link())["connected"] else None, timeout_s
        )

    @contextmanager
    def authority(self) -> Iterator[None]:
        """Take command authority for the ``with`` block, and release it at the end of the block. Authority that was
        held before the block is not released."""
        was_held = self._server.get("/authority")["mine"]
        if not was_held:
            self._server.post("/authority/take")
        try:
            yield
        finally:
            if not was_held:
                self._server.post("/authority/release")

    # -- commands

    def send(self, name: str, *, confirm: str = "", timeout_s: float = 60.0, **arguments: Value) -> Command:
        """Send a command and wait until it is completed. ``confirm``: "yes" for a hazardous command, the name of the
        command for a critical command. Raises CommandFailed if it ends with another result, TimedOut if it does not end
        in time."""
        return self.wait_command(self.submit(name, confirm=confirm, **arguments), timeout_s)

    def submit(self, name: str, *, confirm: str = "", **arguments: Value) -> Command:
        """Queue a command and return it immediately."""
        body = {"name": name, "arguments": arguments, "confirm": confirm}
        return Command.of(self._server.post("/commands", body))

    def command(self, command_id: int) -> Command:
        """Return the command with that id."""
        return Command.of(self._server.get(f"/commands/{command_id}"))

    def wait_command(self, command: Command, timeout_s: float = 60.0) -> Command:
        """Wait until a command is completed. Raises CommandFailed or TimedOut if it is not."""
        ended = self._wait_ended(command, self.command, f"{command.name} to end", timeout_s)
        if ended.result != "completed":
            raise CommandFailed(ended)
        return ended

    def commands(self, limit: int = 100) -> list[Command]:
        """Return the latest commands, newest first."""
        return [Command.of(row) for row in self._server.get("/commands", limit=limit)]

    def abort(self) -> None:
        """Send ABORT ahead of all other traffic. It needs no command authority."""
        self._server.post("/commands/abort")

    # -- telemetry and events

    def telemetry(self) -> dict[str, TelemetryValue]:
        """Return the latest value of every field, by ``packet.field``."""
        values = map(TelemetryValue.of, self._server.get("/telemetry/latest")["values"])
        return {f"{value.packet}.{value.name}": value for value in values}

    def wait_telemetry(
        self, field: str, accept: Callable[[TelemetryValue], bool], timeout_s: float = 30.0
    ) -> TelemetryValue:
        """Wait until ``accept`` returns True for the latest value of ``packet.field``. Raises TimedOut, which states
        the last value, or KeyError if the instrument does not have this field."""
        last = self.telemetry()[field]

        def accepted() -> TelemetryValue | None:
            nonlocal last
            last = self.telemetry()[field]
            return last if accept(last) else None

        try:
            return self._wait(field, accepted, timeout_s)
        except TimedOut:
            raise TimedOut(
                f"{field} was not accepted within {timeout_s:g} s; its last value is {last.formatted}."
            ) from None

    def follow(self, packet: str = "", *, after_id: int | None = None, poll_s: float = POLL_S) -> Iterator[Packet]:
        """Yield stored packets continuously, oldest first. ``packet``: name of the packets to include; "": all packets.
        ``after_id``: id after which to start; None: yield only new packets.

        Packets are read from the store in the order of their ids. No packet is lost or repeated, even if the server
        restarts. To continue in another process, store the ``id`` of the last packet.
        """
        path, query = "/telemetry/packets", {"packet": packet} if packet else {}
        if after_id is None:
            newest = self._server.get(path, limit=1)
            after_id = newest[0]["id"] if newest else 0
        while True:
            rows = self._server.get(path, limit=PAGE, after_id=after_id, **query)
            for row in rows:
                after_id = row["id"]
                yield Packet.of(row)
            if len(rows) < PAGE:
                time.sleep(poll_s)

    def follow_events(self, *, after_seq: int | None = None, poll_s: float = POLL_S) -> Iterator[Event]:
        """Yield recorded events continuously, oldest first. No event is lost or repeated. ``after_seq``: number after
        which to start; None: yield only new events."""
        if after_seq is None:
            newest = self._server.get("/events", start=EARLIEST, end=LATEST, limit=1)
            after_seq = newest[-1]["seq"] if newest else 0
        while True:
            rows = self._server.get("/events", after=after_seq, limit=PAGE)
            for row in rows:
                after_seq = row["seq"]
                yield Event.of(row)
            if len(rows) < PAGE:
                time.sleep(poll_s)

    # -- transfers and frames

    def download_frame(self, slot: int, timeout_s: float = 600.0) -> Frame:
        """Download the image in a slot of the sensor and return the stored frame. Raises TransferFailed or
        TimedOut."""
        started = Transfer.of(self._server.post("/frames/download", {"slot": slot, "kind": "frame"}))
        ended = self.wait_transfer(started, timeout_s)
        frame_id = self._wait("the frame to be stored", lambda: self.transfer(ended.id).frame_id, timeout_s)
        return self.frame(frame_id)

    def transfer(self, transfer_id: int) -> Transfer:
        """Return the transfer with that id."""
        return Transfer.of(self._server.get(f"/transfers/{transfer_id}"))

    def wait_transfer(self, transfer: Transfer, timeout_s: float = 600.0) -> Transfer:
        """Wait until a transfer is complete. Raises TransferFailed or TimedOut if it is not."""
        ended = self._wait_ended(transfer, self.transfer, f"transfer {transfer.id} to end", timeout_s)
        if not ended.complete:
            raise TransferFailed(ended)
        return ended

    def frames(self, limit: int = 100, **filters: Value) -> list[Frame]:
        """Return the latest frames, newest first. ``filters``: query parameters of ``GET /api/frames``, for example
        ``outcome="solved"``."""
        return [Frame.of(row) for row in self._server.get("/frames", limit=limit, **filters)["frames"]]

    def frame(self, frame_id: int) -> Frame:
        """Return the frame with that id."""
        return Frame.of(self._server.get(f"/frames/{frame_id}"))

    def pixels(self, frame: Frame | int) -> NDArray[np.generic]:
        """Return the stored pixels, shape (rows, columns), in the stored integer or float type."""
        response = self._server.download(f"/frames/{_id_of(frame)}/raw")
        shape = int(response.headers["X-Rows"]), int(response.headers["X-Columns"])
        return np.frombuffer(response.content, np.dtype(response.headers["X-Dtype"])).reshape(shape)

    def import_frame(self, file: Path, instrument: str = "") -> Frame:
        """Import a FITS, PNG, TIFF or JPEG file. Without ``instrument`` the frame is solved in blind mode."""
        return Frame.of(self._server.upload("/frames/import", file, {"profile": instrument}))

    def solve(self, frame: Frame | int, **options: Value) -> Solution:
        """Run a chain on a stored frame and store the result. ``options``: fields of ``POST /api/frames/{id}/solve``:
        chain, profile, fov_deg, blind, aberration."""
        return Solution.of(self._server.post(f"/frames/{_id_of(frame)}/solve", options))

    def stars(self, solution: Solution | int) -> list[Star]:
        """Return the measured stars of a solution, with names and residuals where they were matched."""
        solution_id = solution if isinstance(solution, int) else solution.id
        return [Star.of(row) for row in self._server.get(f"/solutions/{solution_id}")["stars"]]

    def calibrate(
        self, frames: Sequence[Frame | int], profile: str, timeout_s: float = 600.0, **request: Json
    ) -> Mapping[str, Json]:
        """Calibrate a camera from frames of stars and return the calibration as ``GET /api/calibrations/{id}``
        describes it. The calibration is not active until a user selects it. ``request``: fields of the body of ``POST
        /api/calibrations``. Raises JobFailed."""
        body = {"kind": "stars", "profile": profile, "frame_ids": [_id_of(frame) for frame in frames], **request}
        job = self.wait_job(Job.of(self._server.post("/calibrations", body)), timeout_s)
        calibration: Mapping[str, Json] = self._server.get(f"/calibrations/{job.result['calibration_id']}")
        return calibration

    # -- procedures

    def procedures(self) -> list[Procedure]:
        """Return the stored procedures, sorted by name."""
        return [Procedure.of(row) for row in self._server.get("/procedures")["stored"]]

    def run_procedure(
        self,
        name: str,
        *,
        answers: Mapping[str, str] | None = None,
        confirm: Collection[str] = (),
        timeout_s: float = 600.0,
    ) -> ProcedureRun:
        """Run a stored procedure to its end. ``answers``: responses to questions, by step name; ``confirm``: names of
        the steps whose hazardous command is confirmed. If a step fails or needs an operator, as every hold point does,
        the run is stopped and ProcedureFailed is raised. Raises KeyError if the procedure does not exist."""
        procedure = {stored.name: stored for stored in self.procedures()}[name]
        run = ProcedureRun.of(self._server.post(f"/procedures/{procedure.id}/start", {"automatic": True}))
        deadline_s = time.monotonic() + timeout_s
        while not run.ended:
            if time.monotonic() > deadline_s:
                raise self._stop_run(run, f"not completed within {timeout_s:g} s")
            if run.entries and run.entries[-1]["state"] == "failed":
                raise self._stop_run(run, run.entries[-1]["detail"])
            step = next(step for step in run.steps if step["id"] == run.current)
            body = self._step_request(step, answers or {}, confirm)
            if body is None:
                raise self._stop_run(run, f"a person must do this step ({step['kind']})")
            if body and not run.under_way:
                self._server.post(f"/procedure-runs/{run.id}/step", body)
            time.sleep(POLL_S)
            run = ProcedureRun.of(self._server.get(f"/procedure-runs/{run.id}"))
        if run.state != "completed":
            raise ProcedureFailed(run, f"{run.state}. {run.reason}")
        return run

    @staticmethod
    def _step_request(
        step: Mapping[str, Json], answers: Mapping[str, str], confirm: Collection[str]
    ) -> dict[str, Json] | None:
        """Return the request body that runs a step; {} if the server runs the step automatically, None if the step
        needs an operator."""
        name = step["id"]
        if step["kind"] == "question":
            return {"step": name, "answer": answers[name]} if name in answers else None
        if step["kind"] in ("hold", "sign"):
            return None
        if step["kind"] == "command" and step["confirm_name"]:
            return {"step": name, "confirm": step["confirm_name"]} if name in confirm else None
        return {}

    def _stop_run(self, run: ProcedureRun, reason: str) -> ProcedureFailed:
        """Stop a run and return the error for it."""
        stopped_run = self._server.post(f"/procedure-runs/{run.id}/stop", {"reason": reason[:500]})
        return ProcedureFailed(ProcedureRun.of({**stopped_run, "current": run.current}), reason)

    # -- catalogues and jobs

    def build_catalogue(self, timeout_s: float = 600.0, **request: Json) -> int:
        """Build a catalogue and return its id. ``request``: body of ``POST /api/catalogues``. Raises JobFailed or
        TimedOut."""
        job = self.wait_job(Job.of(self._server.post("/catalogues", request)), timeout_s)
        return int(job.result["catalogue_id"])

    def upload_catalogue(self, catalogue_id: int, bank: str, timeout_s: float = 600.0) -> Transfer:
        """Upload a catalogue to an inactive bank and wait until it is read back and committed. To activate the bank,
        send its activation command."""
        started = Transfer.of(self._server.post(f"/catalogues/{catalogue_id}/upload", {"bank": bank}))
        return self.wait_transfer(started, timeout_s)

    def job(self, job_id: int) -> Job:
        """Return the job with that id."""
        return Job.of(self._server.get(f"/jobs/{job_id}"))

    def wait_job(self, job: Job, timeout_s: float = 600.0) -> Job:
        """Wait until a job is done. Raises JobFailed or TimedOut if it is not."""
        ended = self._wait_ended(job, self.job, f"job {job.id} to end", timeout_s)
        if ended.state != "done":
            raise JobFailed(ended)
        return ended

    # -- waiting

    def _wait_ended(self, record: Ended, read: Callable[[int], Ended], expected: str, timeout_s: float) -> Ended:
        if record.ended:
            return record
        return self._wait(expected, lambda: newest if (newest := read(record.id)).ended else None, timeout_s)

    def _wait(self, expected: str, read: Callable[[], T | None], timeout_s: float) -> T:
        deadline_s = time.monotonic() + timeout_s
        while True:
            value = read()
            if value is not None:
                return value
            if time.monotonic() > deadline_s:
                raise TimedOut(f"Waited {timeout_s:g} s for {expected}.")
            time.sleep(POLL_S)


def _id_of(frame: Frame | int) -> int:
    return frame if isinstance(frame, int) else frame.id
