"""Shared fixtures, and the rule for skips: a missing browser or database server is a printed reason on a laptop and a
failure in continuous integration (GSS_TEST_FORBID_SKIPS=1)."""

from __future__ import annotations

import gc
import glob
import importlib.util
import os
import pwd
import shutil
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import UTC, datetime, timedelta
from functools import lru_cache
from pathlib import Path
from types import ModuleType
from typing import Any
from unittest.mock import patch

import pytest
from xdist.remote import Producer
from xdist.scheduler import LoadFileScheduling

from tools.browser import chromium_for_tests

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
"""Set before numpy is imported, for this process and its children. Several test processes share two cores, and the
second thread of a matrix product takes more time to wait than to compute."""
if hasattr(os, "SCHED_BATCH"):  # Linux
    os.sched_setscheduler(0, os.SCHED_BATCH, os.sched_param(0))
"""For this process and its children: a process that wakes up does not interrupt a computing one. A third fewer changes between
processes, and less processor time, because their caches are kept longer."""
gc.set_threshold(20_000, 20, 50)
"""Seven thousand collected tests are millions of objects, and with the usual thresholds the collector takes 7 % of the time."""
ROOT = Path(__file__).parent.parent
PHOTOGRAPHS = Path(os.environ.get("GSS_SKY_PHOTOGRAPHS", ROOT.parent / "shared" / "data" / "sky-photographs"))


PROXIES = ("nginx", "caddy")
WAITING = ("system", "contract")
"""Folders whose files mostly wait for servers and lines."""
TIMER = pytest.StashKey[Any]()
RUN_ONCE_MORE = pytest.mark.flaky(reruns=1)
"""Real processes, threads and lines need real time, and a machine that pauses for seconds can fail their tests. A failed
test is run once more; the first failure is printed at the end."""


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add ``--evidence``, used by ``make evidence``."""
    parser.addoption("--evidence", action="store_true", help="run every trial of the statistical tests (make evidence)")


class TwoBrowsers(LoadFileScheduling):
    """Distributes files among processes. The browser tests are the longest chain of waiting, so two processes run them:
    every second file each. The files of a process share its browser."""

    def __init__(self, config: pytest.Config, log: Producer) -> None:
        super().__init__(config, log)
        self._browser_files: dict[str, int] = {}

    def _split_scope(self, nodeid: str) -> str:
        file = nodeid.partition("::")[0]
        if "/e2e/" not in file:
            return file
        return f"e2e {self._browser_files.setdefault(file, len(self._browser_files)) % 2}"


def pytest_xdist_make_scheduler(config: pytest.Config, log: Producer) -> TwoBrowsers:
    """Use this scheduler for every ``-n`` run, regardless of ``--dist``."""
    return TwoBrowsers(config, log)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Run browser tests first. Distribute files that wait evenly among files that compute, with none at the end, so that
    two seldom wait at the same time and no process runs a long file while the others are idle."""
    files: dict[Path, list[pytest.Item]] = {}
    for item in items:
        files.setdefault(item.path, []).append(item)
        item.add_marker(RUN_ONCE_MORE)
    order = [path for path in files if path.parent.name == "e2e"]
    waiting = [path for path in files if path.parent.name in WAITING]
    computing = [path for path in files if path not in {*order, *waiting}]
    step = max(1, int(0.8 * len(computing)) // max(1, len(waiting)))
    for k, path in enumerate(waiting):
        order += [path, *computing[k * step : (k + 1) * step]]
    order += computing[len(waiting) * step :]
    items[:] = [item for path in order for item in files[path]]


def pytest_collection_finish() -> None:
    """Exclude modules and collected tests from later collections of garbage, which would examine them each time."""
    gc.freeze()


@pytest.hookimpl(tryfirst=True)
def pytest_unconfigure() -> None:
    """Collect once, and exclude the rest from the five collections of pytest and from the last one of the interpreter: they
    took half a minute of each process."""
    gc.collect()
    gc.freeze()


@pytest.hookimpl(tryfirst=True)
def pytest_timeout_set_timer(item: pytest.Item, settings: Any) -> None:
    """Store the settings of a test's timer for ``_restart_timer``; pytest-timeout starts it."""
    item.stash[TIMER] = settings


def _restart_timer(item: pytest.Item) -> None:
    """Start a test's timer again. pytest-timeout starts it once, and a failure stops it, so that the teardown of a failed
    test and its second attempt could wait forever."""
    if TIMER in item.stash:
        item.config.hook.pytest_timeout_cancel_timer(item=item)
        item.config.hook.pytest_timeout_set_timer(item=item, settings=item.stash[TIMER])


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_teardown(item: pytest.Item) -> None:
    """Limit the time of the teardown after a failure."""
    _restart_timer(item)


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Print the first failure of every test that was run again."""
    for report in terminalreporter.getreports("rerun"):
        terminalreporter.section(f"run again: {report.nodeid}")
        terminalreporter.line(report.longreprtext)


def pytest_runtest_setup(item: pytest.Item) -> None:
    """Limit the time of each attempt, and skip a test whose program or data is absent."""
    _restart_timer(item)
    needs = {
        "browser": (chromium_for_tests() is not None, "no chromium here: apt install chromium"),
        "postgres": (postgres_bin() is not None, "no PostgreSQL server here: apt install postgresql"),
        "proxies": (all(map(shutil.which, PROXIES)), "no nginx and Caddy here: apt install nginx-light caddy"),
        "photographs": (PHOTOGRAPHS.is_dir(), "the folder of sky photographs is absent (GSS_SKY_PHOTOGRAPHS)"),
    }
    for marker, (present, reason) in needs.items():
        if item.get_closest_marker(marker) and not present:
            if os.environ.get("GSS_TEST_FORBID_SKIPS") and marker != "photographs":
                pytest.fail(reason)
            pytest.skip(reason)


def postgres_bin() -> Path | None:
    """Return the folder of the newest PostgreSQL server's programs."""
    servers = sorted(glob.glob("/usr/lib/postgresql/*/bin/postgres"))
    return Path(servers[-1]).parent if servers else None


def free_port() -> int:
    """Return a free loopback port."""
    with socket.create_server(("127.0.0.1", 0)) as probe:
        return int(probe.getsockname()[1])


@lru_cache
def _beside(name: str) -> ModuleType:
    """The module of this file in tests/."""
    specification = importlib.util.spec_from_file_location(f"gss_{name}", ROOT / "tests" / f"{name}.py")
    assert specification is not None
    assert specification.loader is not None
    module = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(module)
    return module


@pytest.fixture(scope="session")
def hostile() -> ModuleType:
    """The module ``hostile_files.py``, which makes small files that are expensive to read."""
    return _beside("hostile_files")


@pytest.fixture(scope="session")
def _preloaded() -> Iterator[Any]:
    nursery = _beside("nursery")
    with nursery.preloaded(nursery.SERVERS) as forks:
        yield forks


@pytest.fixture(scope="module")
def forked(_preloaded: Any) -> Iterator[None]:
    """Fork the processes ``python -m gss`` of a test file from a preloaded one (tests/nursery.py)."""
    _preloaded.install()
    yield
    _preloaded.remove()


@pytest.fixture(scope="module", autouse=True)
def _restored_environment() -> Iterator[None]:
    """Undo changes of the environment by libraries. The import of OpenCV sets LD_LIBRARY_PATH, and a preloaded process forks only
    commands that have its own settings; the others import everything themselves."""
    with patch.dict(os.environ):
        yield


@pytest.fixture(scope="session", autouse=True)
def forked_parsers() -> Iterator[Any]:
    """Fork the processes that parse a file from a preloaded one. ``remove`` of the fixture lets a module start new ones."""
    nursery = _beside("nursery")
    with nursery.preloaded(nursery.PARSERS) as forks:
        forks.install()
        yield forks
        forks.remove()


@pytest.fixture(scope="session")
def postgres_url() -> Iterator[str]:
    """URL of a temporary PostgreSQL server on a free loopback port.

    PostgreSQL refuses to run as root, so it then runs as an unprivileged system user.
    """
    programs = postgres_bin()
    assert programs is not None
    folder = Path(tempfile.mkdtemp(prefix="gss-pg-"))
    user_options: dict[str, Any] = {}
    if os.geteuid() == 0:
        unprivileged = pwd.getpwnam("nobody")
        user_options = {"user": unprivileged.pw_uid, "group": unprivileged.pw_gid, "extra_groups": []}
        os.chown(folder, unprivileged.pw_uid, unprivileged.pw_gid)
    data, port = folder / "data", free_port()
    options = {"check": True, "capture_output": True, "cwd": folder, **user_options}
    subprocess.run([programs / "initdb", "-D", data, "-A", "trust", "-U", "gss", "--no-sync"], **options)
    settings = f"-p {port} -c listen_addresses=127.0.0.1 -c unix_socket_directories={folder} -c fsync=off"
    subprocess.run([programs / "pg_ctl", "-D", data, "-w", "-o", settings, "-l", folder / "log", "start"], **options)
    yield f"postgresql+psycopg://gss@127.0.0.1:{port}/postgres"
    subprocess.run([programs / "pg_ctl", "-D", data, "-m", "immediate", "stop"], **options)
    shutil.rmtree(folder, ignore_errors=True)


@pytest.fixture(scope="session")
def s3_server() -> Iterator[str]:
    """Address of a temporary object store: moto's server as a process."""
    pytest.importorskip("moto", reason="moto is not installed: pip install 'moto[server]'")
    port = free_port()
    command = [sys.executable, "-W", "ignore", "-m", "moto.server", "-H", "127.0.0.1", "-p", str(port)]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    deadline = time.monotonic() + 60
    while time.monotonic() < deadline:
        assert process.poll() is None, "moto's server ended at once"
        try:
            socket.create_connection(("127.0.0.1", port), 0.2).close()
            break
        except OSError:
            time.sleep(0.05)
    yield f"http://127.0.0.1:{port}"
    process.terminate()
    process.wait(60)


@pytest.fixture(scope="session")
def root() -> Path:
    """The repository's root."""
    return ROOT


@pytest.fixture(scope="session")
def photographs() -> Path:
    """The folder of sky photographs."""
    return PHOTOGRAPHS


@pytest.fixture(scope="session")
def signed_in() -> Callable[..., dict[str, str]]:
    """Function that signs a user in without a password, directly in the database, and returns the request headers.
    ``where``: a data folder, Settings, a database URL, or the services of this process. The session does not expire
    when a test advances the clock."""

    def sign_in(where: Any, role: str = "admin", name: str = "") -> dict[str, str]:
        from gss.operations.accounts.secrets import csrf_of, key_hash, new_key
        from gss.store import accounts
        from gss.store.models import SignIn, User

        now, key = datetime.now(UTC), new_key()
        far_future, name = now + timedelta(days=3650), name or role
        with _database(where) as database, database.unit_of_work() as session:
            user = accounts.user_named(session, name)
            if user is None:
                user = User(name=name, enabled=True, password_hash="", created=now, created_by="test")
                session.add(user)
            user.role = role
            session.flush()
            session.add(
                SignIn(
                    user_id=user.id,
                    key_hash=key_hash(key),
                    created=now,
                    last_seen=far_future,
                    expires=far_future,
                    end_reason="",
                    address="",
                    agent="",
                )
            )
        return {"Cookie": f"gss_session={key}", "X-GSS": csrf_of(key)}

    return sign_in


@pytest.fixture(scope="session", autouse=True)
def copied_databases(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Migrate one empty SQLite database per process; every further new database of a test is a copy of its file. Existing
    files, PostgreSQL and named revisions are migrated."""
    from alembic import command
    from sqlalchemy import make_url

    upgrade, lock = command.upgrade, threading.Lock()
    template = tmp_path_factory.mktemp("template") / "gss.db"

    def copy_or_upgrade(config: Any, revision: str) -> None:
        url = make_url(config.get_main_option("sqlalchemy.url"))
        target = Path(url.database or "")
        if revision != "head" or url.get_backend_name() != "sqlite" or target.exists():
            upgrade(config, revision)
            return
        with lock:
            if not template.exists():
                config.set_main_option("sqlalchemy.url", f"sqlite:///{template}")
                upgrade(config, revision)
        shutil.copyfile(template, target)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(command, "upgrade", copy_or_upgrade)
        yield


@contextmanager
def _database(where: Any) -> Iterator[Any]:
    from gss.settings import Settings
    from gss.store.engine import Database, open_engine
    from gss.store.migration import migrate

    if not isinstance(where, str | Path | Settings):  # services
        yield where.base.database
        return
    settings = where if isinstance(where, Settings) else None
    if settings is None and isinstance(where, Path):
        settings = Settings(data=where)
    if settings is not None:
        settings.data.mkdir(parents=True, exist_ok=True)
    url = where if isinstance(where, str) else settings.database_url if settings else ""
    migrate(url)
    database = Database(open_engine(url))
    yield database
    database.close()


class SensorInMemory:
    """Line to a simulated sensor in this process, for a LinkService. Each read advances the sensor's time by
    ``STEP_S``, so that minutes pass in seconds. ``url``: the address that ``open`` expects."""

    STEP_S, PAUSE_S = 0.01, 0.0004

    def __init__(self, url: str, **identity: Any) -> None:
        import numpy as np

        from gss.device.simulator.factory import burn_golden
        from gss.device.simulator.firmware import StarTracker
        from gss.device.simulator.machine import Identity, SimulatedDevice
        from gss.device.simulator.memory import Memory
        from gss.device.simulator.orbit import Inertial
        from gss.device.simulator.sky import SimulatedSky
        from gss.instruments.dictionary.read_dictionary import load_dictionary
        from gss.instruments.registry import shipped_camera

        self.url, self.now_s, self.cut, self.deaf = url, 100.0, False, False
        self.written: list[bytes] = []
        self.memory, camera = Memory.in_ram(), shipped_camera("cubestar")
        burn_golden(self.memory, camera, _factory_catalogue(self.memory.bank_bytes))
        motion = Inertial.pointing(np.radians(84.0), np.radians(5.0), 0.3)
        self.tracker = StarTracker(camera, SimulatedSky(camera, motion, 2026.0, 1), self.memory)
        self.device = SimulatedDevice(load_dictionary(), Identity(**identity), self.memory, self.tracker, self.now_s)
        self.lock = threading.Lock()
        self._events: Any = None

    def keep_pace_with(self, events: Any) -> None:
        """Advance time only after the ground has handled ``events``, because both ends share the sensor's clock."""
        self._events = events

    def open(self, url: str, baud: int = 0) -> Any:
        """Replacement for gss.device.transport.open_stream."""
        from gss.domain.errors import LinkDown

        if self.cut:
            raise LinkDown("the cable is disconnected", got=url)
        return self

    def monotonic_s(self) -> float:
        """Return the time of both ends. A disconnected cable has no reads, so each call then advances the clock."""
        self.now_s += 0.1 if self.cut else 0.0
        return self.now_s

    def read(self, max_bytes: int, timeout_s: float) -> bytes:
        from gss.domain.errors import LinkDown

        del max_bytes, timeout_s
        time.sleep(self.PAUSE_S)  # let the other threads of this process run
        if self._events is not None:
            self._events.wait_until_handled(0.5)
        if self.cut:
            raise LinkDown("the cable is disconnected")
        with self.lock:
            self.now_s += self.STEP_S
            self.device.advance(self.now_s)
            frames = []
            while (frame := self.device.next_frame(self.now_s)) is not None:
                frames.append(frame)
        return b"".join(frames)

    def write(self, data: bytes) -> None:
        self.written.append(data)
        if not self.deaf:
            with self.lock:
                self.device.feed(data, self.now_s)

    def close(self) -> None:
        """Do nothing: there is nothing to release."""


@lru_cache(maxsize=1)
def _factory_catalogue(bank_bytes: int) -> Any:
    from gss.instruments.golden import build_golden
    from gss.instruments.registry import shipped_camera

    return build_golden(shipped_camera("cubestar"), bank_bytes)


@pytest.fixture
def sensor_in_memory(monkeypatch: pytest.MonkeyPatch) -> Callable[..., SensorInMemory]:
    """Function that makes a simulated sensor and lets the link of this process open it."""

    def make(**identity: Any) -> SensorInMemory:
        sensor = SensorInMemory("memory://sensor", **identity)
        monkeypatch.setattr("gss.operations.line.link.open_stream", sensor.open)
        return sensor

    return make


@pytest.fixture(scope="session")
def tle_of() -> Callable[..., str]:
    """Function that returns named two-line elements of a low polar orbit. The epoch is ``age_days`` before ``now``."""

    def make(age_days: float, now: datetime | None = None) -> str:
        epoch = (now or datetime.now(UTC)) - timedelta(days=age_days)
        day = (epoch - datetime(epoch.year, 1, 1, tzinfo=UTC)) / timedelta(days=1) + 1
        lines = [
            f"1 25544U 98067A   {epoch:%y}{day:012.8f}  .00001764  00000-0  38792-4 0  999",
            "2 25544  97.6439 211.2001 0007417  17.6667  85.6398 15.2010347220248",
        ]
        return "ZA-1\n" + "".join(f"{x}{sum(int(c) if c.isdigit() else c == '-' for c in x) % 10}\n" for x in lines)

    return make
