"""Replay of frames: the sensor's chain is rerun on the ground with the sensor's frame, bank and parameters, and the results are
compared."""

from __future__ import annotations

import math
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gss.catalogue_tools.formats.triplet_table import decode_triplets
from gss.device.table_use import calibrated, chain_of, parameters_with
from gss.device.tables import BAD_PIXELS, NO_PIXELS, decode_bad_pixels, decode_table
from gss.domain.camera_profile import CameraProfile
from gss.domain.errors import GssError, NotFound
from gss.domain.results import SolveResult
from gss.instruments.registry import Registry
from gss.operations.clock import Monotonic
from gss.operations.frames.frames import FrameService
from gss.operations.frames.onboard_reported import frame_as_used, record_from
from gss.operations.frames.onboard_results import OnboardRecord
from gss.operations.frames.replay_stages import ReplayStage, Rerun, StageVerdict, first_difference, stages
from gss.operations.transfers.banks import BankService
from gss.operations.transfers.device_tables import DeviceTableService
from gss.pipeline.chains.modes import Mode
from gss.pipeline.chains.oersted_match import prepare as prepare_with_triplets
from gss.pipeline.chains.onboard import Commanded, OnboardChain, Work, solve
from gss.pipeline.fixed_pattern import without_bad_pixels
from gss.pipeline.trace import Trace
from gss.skytables.bank import OnboardCatalogue
from gss.store.models import Frame, Solution


class ReplayService:
    """Reruns the sensor's chain on frames of the device, one frame at a time, in a separate thread."""

    def __init__(
        self,
        frames: FrameService,
        banks: BankService,
        tables: DeviceTableService,
        instruments: Registry,
        stopwatch_s: Monotonic,
    ) -> None:
        self._instruments = instruments
        self._frames, self._banks, self._tables, self._stopwatch_s = frames, banks, tables, stopwatch_s
        self._pool = ThreadPoolExecutor(max_workers=1, thread_name_prefix="replay")
        self._last_prepared: tuple[tuple[Any, ...], Any] | None = None

    def stop(self) -> None:
        """Stop after the current replay."""
        self._pool.shutdown(wait=True, cancel_futures=True)

    def queue(self, frame: Frame, record: OnboardRecord, on_board: Solution) -> None:
        """Queue a rerun of a frame. Its result is stored and compared with the sensor's result."""
        self._pool.submit(self._run, frame, record, on_board)

    def _run(self, frame: Frame, record: OnboardRecord, on_board: Solution) -> None:
        try:
            rerun = self.rerun(frame, record)
            text = compare(record, rerun)
        except GssError as error:
            self._frames.set_replay(on_board.id, f"not replayed: {error}")
            return
        # The thread must continue after a defect, which is displayed instead of the comparison.
        except Exception as error:
            self._frames.set_replay(on_board.id, f"not replayed: internal error, {type(error).__name__}: {error}")
            return
        self._frames.set_replay(on_board.id, text)
        self._frames.keep_replay(frame, rerun.result, text)

    def again(self, frame_id: int) -> list[ReplayStage]:
        """Replay a stored frame and return the comparison of all stages. Raises NotFound if the sensor reported no result for the
        frame, GssError if the ground does not have the bank, the tables or the prior attitude that the sensor used."""
        detail = self._frames.detail(frame_id)
        stored = {} if detail.on_board is None else detail.on_board.detail
        reported = stored.get("reported") or stored.get("told")  # "told": the key that version 0.4 stored
        if reported is None:
            raise NotFound(
                "nothing to replay",
                expected="a frame whose centroids and attitude were received",
                got=f"frame {frame_id}",
                hint="results stored by an earlier version do not contain the initial state of the sensor",
            )
        frame = frame_as_used(detail.frame, reported)
        record = record_from(reported, self._banks.hip_of_row(frame.bank_sha256 or ""))
        return [*self._used(frame), *stages(record, self.rerun(frame, record))]

    def _used(self, frame: Frame) -> list[ReplayStage]:
        """Return the bank and the tables that the sensor used as stages of the comparison."""
        bank, tables = frame.bank_sha256 or "", frame.parameters.get("tables", {})
        rows = [("bank", bank)] + [(f"{kind} table", sha256) for kind, sha256 in sorted(tables.items())]
        return [
            ReplayStage(name, StageVerdict.EQUAL, sha256[:12], sha256[:12])
            if sha256
            else ReplayStage(name, StageVerdict.NOT_SENT, "not sent", "–")
            for name, sha256 in rows
        ]

    def rerun(self, frame: Frame, record: OnboardRecord) -> Rerun:
        """Run the sensor's chain with the bank, tables and parameters that were active. Raises GssError if they are unknown."""
        bank = self._banks.onboard(frame.bank_sha256 or "")
        if bank is None:
            raise GssError(
                "the content of the bank that was active is not available on the ground",
                got=(frame.bank_sha256 or "no hash")[:12],
            )
        shelf = self._shelf(frame)
        profile, chain, mode = shelf.profile, shelf.chain, _mode(record)
        parameters = parameters_with(shelf.parameters, profile, frame.exposure_s, commanded(frame, record), mode)
        picture: Any = self._frames.picture(frame)
        pixels, dark = profile.sensor.dark_columns.split(picture, profile.camera.columns)
        hint = record.prior.hint(mode, _frame_time_s(record))
        if mode is not Mode.LOST_IN_SPACE and hint is None:
            raise GssError("the initial attitude of the sensor was not received")
        prepared = self._prepared(shelf, frame.bank_sha256 or "", bank)
        work = Work(profile.camera, prepared, parameters, mode, hint, dark)
        trace = Trace(self._stopwatch_s)
        result = solve(chain, without_bad_pixels(pixels, shelf.bad_pixels), work, trace=trace)
        stages: Any = trace.kept
        return Rerun(result, stages["detection"], stages["matching"])

    def _shelf(self, frame: Frame) -> Shelf:
        """Return the effect of the tables that were active when the frame was taken. The tables are read from the store."""
        used: Mapping[str, str] = frame.parameters.get("tables", {})
        table_bytes = {kind: self._tables.bytes_of(kind, sha256) for kind, sha256 in used.items()}
        if frame.profile is None:
            raise GssError("the camera of the frame is unknown", expected="a frame of a known instrument")
        uncalibrated = self._instruments.camera(frame.profile)
        values = {
            kind: decode_table(kind, table_bytes[kind])[1]
            for kind in ("calibration", "parameters")
            if kind in table_bytes
        }
        camera = calibrated(uncalibrated, values["calibration"]) if "calibration" in values else uncalibrated
        parameters = values.get("parameters", {})
        triplets = decode_triplets(table_bytes["triplets"]) if "triplets" in table_bytes else None
        bad_pixels = decode_bad_pixels(table_bytes[BAD_PIXELS])[1] if BAD_PIXELS in table_bytes else NO_PIXELS
        key = tuple(sorted(used.items()))
        return Shelf(camera, chain_of(uncalibrated, parameters), parameters, triplets, bad_pixels, key)

    def _prepared(self, shelf: Shelf, sha256: str, bank: OnboardCatalogue) -> Any:
        """Return the bank in the form that the chain prepares. Only the last prepared bank is cached."""
        # Not by name, because a replaced package has the same one.
        key = (shelf.chain.name, shelf.profile.camera, shelf.profile.sensor, sha256, shelf.key)
        last = self._last_prepared  # read once, because replays run in several threads
        if last is None or last[0] != key:
            prepared = shelf.chain.prepare(bank, shelf.profile)
            if shelf.triplets is not None and hasattr(prepared, "triplets"):
                prepared = prepare_with_triplets(bank, shelf.profile, shelf.triplets)
            self._last_prepared = last = key, prepared
        return last[1]


@dataclass(frozen=True)
class Shelf:
    """Effect of the sensor's tables: camera, chain, changed constants of the chain (``parameters``), triplets, and (k, 2)
    bad pixels."""

    profile: CameraProfile
    chain: OnboardChain
    parameters: Mapping[str, Any]
    triplets: Any
    bad_pixels: NDArray[np.intp]
    key: tuple[tuple[str, str], ...]


def commanded(frame: Frame, record: OnboardRecord) -> Commanded:
    """Return the commanded settings that housekeeping reported when the frame was taken, and the radius of the hint. A reported
    threshold of 0 means the default of the chain."""
    onboard = frame.parameters
    return Commanded(
        threshold_dn=onboard.get("threshold_dn") or None,
        min_area_px=onboard.get("min_pixels"),
        max_area_px=onboard.get("max_pixels"),
        hint_radius_rad=record.prior.radius_rad(_mode(record)),
    )


def _mode(record: OnboardRecord) -> Mode:
    return Mode(str((record.attitude or {}).get("mode", "lost_in_space")))


def _frame_time_s(record: OnboardRecord) -> float:
    return float((record.attitude or {}).get("frame_time_s", math.nan))


def compare(record: OnboardRecord, rerun: Rerun | SolveResult) -> str:
    """Return "equal" or the first stage that differs."""
    return first_difference(stages(record, rerun if isinstance(rerun, Rerun) else Rerun(rerun)))
