"""Check that the command line reaches every stage of docs/chains.md: run ``gss`` and record the called functions."""

from __future__ import annotations

import contextlib
import io
import re
import sys
import tempfile
import threading
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import CodeType, FrameType
from typing import TYPE_CHECKING

from gss.cli import main

if TYPE_CHECKING:
    from tools.chain_stages import ChainStage

ROOT = Path(__file__).parent.parent
ORION_DEG = (84.0, 0.0, 20.0)
"""Right ascension, declination and roll of the first image. At this pointing, every camera sees enough bright stars."""
ROTATION_DEG = 0.05
"""Rotation between two images of a sequence."""
SEQUENCE = 4
FEW_STARS_S = "0.02"
"""Exposure with which far_mst detects 11 stars."""
FALSE_STARS = "60"
"""Number of false stars with which the vote of oersted fails."""
OPTION = re.compile(r"`(--[^`]*)`")


@dataclass(frozen=True)
class Scene:
    """Images of one system's camera: ``plain``: sequence; ``few``: the same sequence with few stars in the third image;
    ``crowded``: image with false stars; ``dark``: images without stars."""

    system: str
    plain: tuple[Path, ...]
    few: tuple[Path, ...]
    crowded: Path
    dark: tuple[Path, ...]


def render_scene(system: str, folder: Path) -> Scene:
    """Render the images with ``gss render``. Raises RuntimeError if that fails."""

    def image(name: str, k: int, *options: str) -> Path:
        ra, dec, roll = ORION_DEG
        out = folder / f"{system}-{name}-{k}.png"
        at = f"{ra + k * ROTATION_DEG},{dec},{roll}"
        with contextlib.redirect_stdout(io.StringIO()):
            code = main(["render", "--camera", system, "--at", at, "--out", str(out), "--seed", str(k + 1), *options])
        if code != 0:
            raise RuntimeError(f"gss render --camera {system} failed with exit code {code}")
        return out

    plain = tuple(image("plain", k) for k in range(SEQUENCE))
    few = (*plain[:2], image("few", 2, "--exposure", FEW_STARS_S), plain[3])
    dark = tuple(image("dark", k, "--exposure", "0.000001") for k in range(SEQUENCE))
    return Scene(system, plain, few, image("crowded", 0, "--false-stars", FALSE_STARS), dark)


def unreached(stages: Mapping[str, Sequence[ChainStage]]) -> list[str]:
    """Run the command of every stage. Return a line for each stage that its command does not call, or that is called
    although an option disables it. Stages that only the simulated unit runs are tested elsewhere."""
    missing: list[str] = []
    with tempfile.TemporaryDirectory() as folder:
        for system, rows in stages.items():
            scene, calls_by_command = render_scene(system, Path(folder)), {}
            for stage in rows:
                if stage.by_unit:
                    continue
                arguments = command(scene, stage)
                if arguments not in calls_by_command:
                    calls_by_command[arguments] = called(arguments)
                if not _is_in(stage.full_name, calls_by_command[arguments]):
                    missing.append(f"{system}: {stage.where} is not called by gss {' '.join(arguments)}")
                if stage.left_out_by:
                    calls_without = called(_solve(scene, stage.left_out_by, scene.plain[:1]))
                    if _is_in(stage.full_name, calls_without):
                        missing.append(f"{system}: {stage.where} is called with {stage.left_out_by}")
    return missing


def command(scene: Scene, stage: ChainStage) -> tuple[str, ...]:
    """Return the arguments of ``gss`` that reach a stage."""
    if stage.scene == "dark":
        return ("calibrate", *map(str, scene.dark), "--camera", scene.system, "--darks")
    if stage.scene == "rate":
        return ("rate", *map(str, scene.plain), "--camera", scene.system, "--interval", "1")
    if stage.scene == "experiment":
        (words,) = re.findall(r"`gss ([^`]*)`", stage.reach)
        return (*words.split(), "--trials", "40")
    options = (
        "" if stage.left_out_by or stage.reach.startswith("without") else " ".join(OPTION.findall(stage.reach)[:1])
    )
    if stage.scene == "crowded":
        return _solve(scene, options, (scene.crowded,))
    images = scene.few if stage.scene == "few" else scene.plain
    return _solve(scene, options, images if "--sequence" in options else images[:1])


def _solve(scene: Scene, options: str, images: Sequence[Path]) -> tuple[str, ...]:
    ra, dec, roll = ORION_DEG
    arguments = options.replace("RA,DEC,ROLL", f"{ra},{dec},{roll}").replace("--interval S", "--interval 1").split()
    return ("solve", *map(str, images), "--camera", scene.system, "--chain", scene.system, *arguments)


def called(arguments: Sequence[str]) -> frozenset[str]:
    """Run ``gss`` in this process and return the functions of GSS that it called, as module:name."""
    with (
        recorded() as names,
        contextlib.redirect_stdout(io.StringIO()),
        contextlib.redirect_stderr(io.StringIO()),
    ):
        main(list(arguments))
    return frozenset(names)


@contextlib.contextmanager
def recorded() -> Iterator[set[str]]:
    """Yield a set that, after the block, contains the functions of GSS called in the block."""
    codes: set[CodeType] = set()
    names: set[str] = set()

    def note(frame: FrameType, _event: str, _argument: object) -> None:
        """Record a function at its start. Without a return value, its lines and its end are not traced, which would take
        several times as long."""
        codes.add(frame.f_code)

    tracing = sys.gettrace()
    threading.settrace(note)
    sys.settrace(note)
    try:
        yield names
    finally:
        sys.settrace(tracing)
        threading.settrace(None)
        for code in tuple(codes):  # threads that are still running add functions
            path = Path(code.co_filename)
            if path.is_relative_to(ROOT / "gss"):
                module = ".".join(path.relative_to(ROOT).with_suffix("").parts)
                names.add(f"{module}:{code.co_qualname}")


def _is_in(name: str, calls: frozenset[str] | set[str]) -> bool:
    return name in calls or any(call.startswith(f"{name}.") for call in calls)
