"""``python -m tools.fuzz TARGET --minutes N``: search for input that violates a parser's contract, starting from the
corpus.

With atheris (``pip install atheris``) the search is guided by coverage; otherwise a seeded generator mutates bytes. A
failing input is written to the corpus as ``regression-…``, and the tests then replay it. ``all`` runs every target.
"""

from __future__ import annotations

import argparse
import hashlib
import random
import resource
import signal
import subprocess
import sys
import time
import traceback
import warnings
from collections.abc import Callable
from pathlib import Path
from types import FrameType

CORPUS = Path(__file__).parent.parent / "tests" / "fuzz" / "corpus"
MAX_S = 10
MAX_MEMORY_BYTES = 4 << 30
INTERESTING = (0, 1, 0x7F, 0x80, 0xFF, 0x7FFF, 0xFFFF, 0x7FFF_FFFF, 0xFFFF_FFFF)
WORDS = (
    *b'nan inf -1 0 1e999 99999999999999999999 null true {} [] "" " \' # *a , : [[[[[[[[ 1_000 0x10 2026-13-45'.split(),
    *(
        b"&a ",
        b"\n",
        b"\r\n",
        b"\t",
        b": ",
        b"- ",
        b"  ",
        b"{a: {a: {a: ",
        b"!!python/name:os.system ",
        b"<!ENTITY a 'b'>",
    ),
    *(b"\0", b"\xff\xfe", "²".encode(), "−".encode(), "٣".encode()),
)


def seeds_of(target: str) -> list[bytes]:
    """Return the stored inputs of a target, sorted by file name."""
    return [path.read_bytes() for path in sorted((CORPUS / target).iterdir()) if path.is_file()]


def mutated(rng: random.Random, pool: list[bytes], max_bytes: int, text: bool) -> bytes:
    """Return an input of the pool with a few random changes."""
    data = bytearray(rng.choice(pool))
    for _ in range(1 << rng.randrange(4)):
        _change(rng, data, pool, text)
    return bytes(data[:max_bytes])


def _change(rng: random.Random, data: bytearray, pool: list[bytes], text: bool) -> None:
    at = rng.randrange(len(data) + 1)
    end = min(len(data), at + 1 + min(int(rng.expovariate(0.1)), 400))
    kind = rng.randrange(9 if text else 7)
    if kind == 0 and data:
        data[at % len(data)] ^= 1 << rng.randrange(8)
    elif kind == 1 and data:
        data[at % len(data)] = rng.randrange(256)
    elif kind == 2:
        del data[at:end]
    elif kind == 3:
        data[at:at] = data[at:end] * rng.choice((1, 1, 2, 20))
    elif kind == 4:
        other = rng.choice(pool)
        start = rng.randrange(len(other) + 1)
        data[at:end] = other[start : start + rng.randrange(400)]
    elif kind == 5:
        size = rng.choice((1, 2, 4, 8))
        value = rng.choice(INTERESTING) & ((1 << 8 * size) - 1)
        data[at : at + size] = value.to_bytes(size, rng.choice(("big", "little")))
    elif kind == 6:
        data[at:end] = rng.choice(WORDS)
    elif kind == 7:
        _swap_line(rng, data)
    else:
        _swap_token(rng, data)


def _swap_line(rng: random.Random, data: bytearray) -> None:
    lines = bytes(data).split(b"\n")
    i, j = rng.randrange(len(lines)), rng.randrange(len(lines))
    lines[i] = lines[j] if rng.random() < 0.5 else b""
    data[:] = b"\n".join(lines)


def _swap_token(rng: random.Random, data: bytearray) -> None:
    """Replace one value with a word that has caused parser defects before."""
    marks = [i for i, c in enumerate(data) if c in b' ,:[]{}<>"=\n\t;']
    if len(marks) > 1:
        i = rng.randrange(len(marks) - 1)
        data[marks[i] + 1 : marks[i + 1]] = rng.choice(WORDS)


class InputTimeoutError(BaseException):
    """An input exceeded the time limit. Not an Exception, because parsers convert those into errors of GSS."""


def search(
    name: str, seconds: float, seed: int, keep: Callable[[bytes, BaseException], None], max_s: float = MAX_S
) -> tuple[int, float]:
    """Run mutated inputs for ``seconds``, each for at most ``max_s``. ``keep`` is called with each failing input. Return
    the number of inputs and the longest duration in seconds."""
    from tools.fuzz_targets import TARGETS

    target, pool, rng = TARGETS[name], seeds_of(name), random.Random(seed)  # not a secret
    signal.signal(signal.SIGALRM, _raise_timeout)
    end_s, count, slowest_s = time.monotonic() + seconds, 0, 0.0
    while time.monotonic() < end_s:
        data = mutated(rng, pool, target.max_bytes, target.text)
        start_s = time.monotonic()
        try:
            _run_limited(target.fuzz_one, data, max_s)
        except (Exception, InputTimeoutError) as error:  # any exception other than GssError is a defect
            keep(data, error)
        count, slowest_s = count + 1, max(slowest_s, time.monotonic() - start_s)
    return count, slowest_s


def _run_limited(fuzz_one: Callable[[bytes], None], data: bytes, max_s: float) -> None:
    """Run one input. Raises InputTimeoutError after ``max_s``, also if the input suppressed the one of the timer."""
    start_s = time.monotonic()
    signal.setitimer(signal.ITIMER_REAL, max_s, max_s)  # again, for an input that suppresses the error and continues
    try:
        fuzz_one(data)
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
    if time.monotonic() - start_s >= max_s:
        raise InputTimeoutError("time limit for one input exceeded")


def _raise_timeout(_signal: int, _frame: FrameType | None) -> None:
    raise InputTimeoutError("time limit for one input exceeded")


def keep_in_corpus(name: str, seen: set[str]) -> Callable[[bytes, BaseException], None]:
    """Return a function that writes the first failing input of each raising location."""

    def keep(data: bytes, error: BaseException) -> None:
        frame = traceback.extract_tb(error.__traceback__)[-1]
        innermost = next(
            (f for f in reversed(traceback.extract_tb(error.__traceback__)) if "/gss/" in f.filename), frame
        )
        location = f"{type(error).__name__} in {Path(innermost.filename).name}:{innermost.lineno} {innermost.name}"
        if location in seen:
            return
        seen.add(location)
        path = CORPUS / name / f"regression-{hashlib.sha256(data).hexdigest()[:10]}"
        path.write_bytes(data)
        print(f"{name}: {location}: {str(error)[:200]}\n  stored as {path.name}", flush=True)

    return keep


def _with_atheris(name: str, seconds: int) -> int:
    """Run the search in a child process, because libFuzzer ends the process at the first failure."""
    import tempfile

    with tempfile.TemporaryDirectory() as folder:
        code = f"import tools.fuzz as f; f.atheris_main({name!r})"
        options = [
            folder,
            str(CORPUS / name),
            f"-max_total_time={seconds}",
            f"-timeout={MAX_S}",
            "-rss_limit_mb=4096",
        ]
        options += [f"-artifact_prefix={CORPUS / name}/regression-", "-print_final_stats=1", "-verbosity=1"]
        return subprocess.run([sys.executable, "-c", code, *options], check=False).returncode


def atheris_main(name: str) -> None:
    """Run the target in the process that libFuzzer controls."""
    import atheris

    with atheris.instrument_imports(include=["gss"]):
        from tools.fuzz_targets import TARGETS
    warnings.simplefilter("ignore")
    atheris.Setup(sys.argv, TARGETS[name].fuzz_one)
    atheris.Fuzz()


def main() -> int:
    """Search all selected targets. Return 1 if a defect was detected."""
    from tools.fuzz_targets import TARGETS

    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("target", choices=[*TARGETS, "all"])
    parser.add_argument("--minutes", type=float, default=1.0, help="minutes for each target")
    parser.add_argument("--seed", type=int, default=int(time.time()), help="seed of the mutations without atheris")
    parser.add_argument("--engine", choices=("auto", "atheris", "own"), default="auto")
    arguments = parser.parse_args()
    names = list(TARGETS) if arguments.target == "all" else [arguments.target]
    resource.setrlimit(resource.RLIMIT_AS, (MAX_MEMORY_BYTES, MAX_MEMORY_BYTES))
    warnings.simplefilter("ignore")
    failed = False
    for name in names:
        if arguments.engine == "atheris" or (arguments.engine == "auto" and _has_atheris()):
            failed |= _with_atheris(name, int(arguments.minutes * 60)) != 0
            continue
        seen: set[str] = set()
        count, slowest_s = search(name, arguments.minutes * 60, arguments.seed, keep_in_corpus(name, seen))
        print(
            f"{name}: {count} inputs, seed {arguments.seed}, slowest {slowest_s:.2f} s, {len(seen)} defects", flush=True
        )
        failed |= bool(seen)
    return int(failed)


def _has_atheris() -> bool:
    import importlib.util

    return importlib.util.find_spec("atheris") is not None


if __name__ == "__main__":
    sys.exit(main())
