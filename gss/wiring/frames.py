"""Services of frames and their solutions."""

from __future__ import annotations

from dataclasses import dataclass

from gss.catalogue_tools.envelope.orbits import jyear_of
from gss.operations.clock import stopwatch_s
from gss.operations.frames.dark_frames import DarkFrames
from gss.operations.frames.frames import FrameService
from gss.operations.frames.loop_compiler import LoopCompiler, compile_command
from gss.operations.frames.replay import ReplayService
from gss.operations.frames.solve import Solver
from gss.operations.frames.solver_cache import SolverCache
from gss.operations.studies.camera_book import CameraBook
from gss.operations.transfers.downloads import Downloads
from gss.pipeline.kernels import are_compiled
from gss.wiring.base import BaseServices
from gss.wiring.line import Line
from gss.wiring.transfers import Transfers


@dataclass(frozen=True)
class Frames:
    """Services that request, store, solve and replay frames. ``epoch_jyear``: epoch of the star positions."""

    book: CameraBook
    darks: DarkFrames
    solver: Solver
    epoch_jyear: float
    frames: FrameService
    replay: ReplayService
    downloads: Downloads
    compiler: LoopCompiler


def open_frames(base: BaseServices, line: Line, transfers: Transfers) -> Frames:
    """Create the frame services."""
    database, blobs, epoch_jyear = base.database, base.blobs, jyear_of(base.clock.now())
    book, darks = CameraBook(database, base.instruments, base.bus, base.clock.now), DarkFrames(blobs)
    cache = SolverCache(base.stars, folder=base.settings.data / "figures")
    solver = Solver(book.profile, cache, stopwatch_s, epoch_jyear=epoch_jyear, dark=darks.pattern)
    frames = FrameService(
        database,
        blobs,
        base.bus,
        solver,
        # Overlays and verdicts need current star positions. With the positions at the catalogue's epoch, a star at the
        # edge could be outside the frame.
        cache.stars(epoch_jyear),
        base.clock.now,
        base.settings.solve_chain,
        base.parsing,
        base.disk.check,
        base.instruments,
    )
    replay = ReplayService(frames, transfers.banks, transfers.tables, base.instruments, stopwatch_s)
    downloads = Downloads(line.link, transfers.transfers, frames)
    compiler = LoopCompiler(compile_command(), are_compiled, base.bus)
    return Frames(book, darks, solver, epoch_jyear, frames, replay, downloads, compiler)
