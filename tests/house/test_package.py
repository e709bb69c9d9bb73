"""Release archives: the wheel contains all that it needs, the source archive builds the same wheel, and the server
starts from the wheel alone.
"""

from __future__ import annotations

import json
import os
import re
import sqlite3
import subprocess
import sys
import sysconfig
import tarfile
import urllib.error
import urllib.request
import zipfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import gss
from gss.domain.frames import cam_from_icrs
from gss.instruments.registry import shipped_camera
from gss.operations.frames.solver_cache import SolverCache
from gss.pipeline.render import render

EPOCH = "1700000000"
pytestmark = [pytest.mark.timeout(600), pytest.mark.xdist_group("package")]


def build(root: Path, kind: str, target: Path) -> Path:
    """Build one archive with the build backend directly, as pip does without isolation, and so without a download."""
    command = [sys.executable, "-m", "hatchling", "build", "-t", kind, "-d", str(target)]
    result = subprocess.run(
        command, cwd=root, env={**os.environ, "SOURCE_DATE_EPOCH": EPOCH}, capture_output=True, text=True
    )
    assert result.returncode == 0, result.stdout + result.stderr
    (archive,) = target.iterdir()
    return archive


@pytest.fixture(scope="module")
def sdist(root: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Source archive of this tree. Requires the pages, which ``make`` builds."""
    if not (root / "gss" / "web" / "index.html").exists():
        pytest.fail("the pages have not been built: make web")
    return build(root, "sdist", tmp_path_factory.mktemp("sdist"))


@pytest.fixture(scope="module")
def unpacked(sdist: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The unpacked source archive."""
    folder = tmp_path_factory.mktemp("unpacked")
    with tarfile.open(sdist) as archive:
        archive.extractall(folder, filter="data")
    return next(folder.iterdir())


@pytest.fixture(scope="module")
def wheel(unpacked: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Wheel built from the source archive."""
    return build(unpacked, "wheel", tmp_path_factory.mktemp("wheel"))


@pytest.fixture(scope="module")
def installed(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """``bin`` of an environment with the wheel and no file of this tree.

    Dependencies are those of the test environment, so that only the wheel is tested and nothing is downloaded.
    """
    venv = tmp_path_factory.mktemp("installed") / "venv"
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", str(venv)], check=True)
    site = next(venv.glob("lib/python*/site-packages"))
    (site / "dependencies.pth").write_text(
        sysconfig.get_path("purelib") + "\n"
    )  # .pth files in that folder are not read
    pip = [sys.executable, "-m", "pip", "--python", str(venv / "bin" / "python"), "--disable-pip-version-check"]
    subprocess.run(
        [*pip, "install", "--quiet", "--no-deps", "--no-index", "--ignore-installed", str(wheel)], check=True
    )
    return venv / "bin"


def names_in(wheel: Path) -> set[str]:
    """Return the file names in a wheel."""
    with zipfile.ZipFile(wheel) as archive:
        return set(archive.namelist())


def test_the_wheel_has_what_runs_and_nothing_else(root: Path, wheel: Path) -> None:
    """The wheel contains pages, migrations, documents and data, but no tests, tools or page sources."""
    names = names_in(wheel)
    for folder, inside in (("gss", "gss"), ("migrations", "gss/migrations"), ("docs", "gss/docs")):
        tracked = subprocess.run(["git", "ls-files", folder], cwd=root, capture_output=True, text=True).stdout.split()
        files = tracked or [str(p.relative_to(root)) for p in (root / folder).rglob("*.py")]
        existing = [f for f in files if (root / f).exists()]
        assert {inside + f.removeprefix(folder) for f in existing} <= names
    assert {"gss/web/index.html", "gss/instruments/dictionary/gss-common.yaml"} <= names
    assert any(re.fullmatch(r"gss/web/assets/index-.*\.js", name) for name in names)
    foreign = {n for n in names if not n.startswith(("gss/", f"gss_startracker-{gss.__version__}.dist-info/"))}
    assert not foreign
    assert not [n for n in names if "node_modules" in n or n.endswith((".pyc", ".svelte", ".ts"))]


def test_version_of_wheel_and_source_is_the_package_s(sdist: Path, wheel: Path) -> None:
    """Both archives have the version that gss/__init__.py defines."""
    assert sdist.name == f"gss_startracker-{gss.__version__}.tar.gz"
    assert wheel.name == f"gss_startracker-{gss.__version__}-py3-none-any.whl"


def test_the_source_archive_has_all_that_the_repository_has(root: Path, unpacked: Path) -> None:
    """The source archive contains every tracked file needed to build, test and deploy."""
    tracked = subprocess.run(["git", "ls-files"], cwd=root, capture_output=True, text=True).stdout.splitlines()
    if not tracked:
        pytest.skip("not a git checkout: the repository's files are unknown")
    folders = ("gss", "validation", "migrations", "web", "tools", "tests", "docs", "deploy")
    expected_files = [f for f in tracked if f.split("/")[0] in folders and (root / f).exists()]
    assert not [f for f in expected_files if not (unpacked / f).exists()]
    for name in (
        "LICENSE",
        "README.md",
        "CHANGELOG.md",
        "SECURITY.md",
        "Makefile",
        "constraints.txt",
        "constraints-dev.txt",
        "pyproject.toml",
    ):
        assert (unpacked / name).exists(), name


def test_two_builds_give_the_same_bytes(unpacked: Path, sdist: Path, wheel: Path, tmp_path: Path) -> None:
    """The build is reproducible: a second wheel, and an archive built from the unpacked archive, have the same bytes."""
    assert build(unpacked, "wheel", tmp_path / "again").read_bytes() == wheel.read_bytes()
    assert build(unpacked, "sdist", tmp_path / "source").read_bytes() == sdist.read_bytes()


def test_experiments_are_a_separate_wheel(root: Path, unpacked: Path, installed: Path, tmp_path: Path) -> None:
    """Without the validation wheel, ``gss experiments`` names the command that installs it; with it, the experiments
    are listed. Both wheels require the same version.
    """
    environment = {k: v for k, v in os.environ.items() if not k.startswith(("GSS_", "PYTHON"))}

    def experiments(**variables: str) -> subprocess.CompletedProcess[str]:
        command = [installed / "gss", "experiments", "list"]
        return subprocess.run(command, cwd=tmp_path, env=environment | variables, capture_output=True, text=True)

    not_installed = experiments()
    assert not_installed.returncode == 2
    assert "pip install 'gss-startracker[validation]'" in not_installed.stderr
    wheel = build(unpacked / "validation", "wheel", tmp_path / "wheel")
    assert wheel.name == f"gss_startracker_validation-{gss.__version__}-py3-none-any.whl"
    sources = {str(p.relative_to(root)) for p in (root / "validation").rglob("*.py")}
    assert {n for n in names_in(wheel) if ".dist-info/" not in n} == sources
    listed = experiments(PYTHONPATH=str(wheel))
    assert listed.returncode == 0, listed.stderr
    assert "erlank-3-6" in listed.stdout
    for file, name in (
        ("pyproject.toml", "gss-startracker-validation"),
        ("validation/pyproject.toml", "gss-startracker"),
    ):
        assert f'"{name}=={gss.__version__}"' in (root / file).read_text()


@pytest.fixture(scope="module")
def served(installed: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[str, Path]]:
    """Yield the start message and the data folder of a server from the wheel, started in an empty folder."""
    folder = tmp_path_factory.mktemp("elsewhere")
    environment = {k: v for k, v in os.environ.items() if not k.startswith(("GSS_", "PYTHON"))}
    command = [str(installed / "gss"), "serve", "--port", "0", "--data", "data"]
    process = subprocess.Popen(command, cwd=folder, env=environment, stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    line = next((text for text in process.stdout if "http://" in text), "")
    yield line, folder / "data"
    process.terminate()
    process.wait(timeout=30)
    process.stdout.close()


def test_the_installed_program_is_the_wheel_s(installed: Path, tmp_path: Path) -> None:
    """The program runs from any folder and prints its version. It imports gss from the wheel, not from this tree."""
    version = subprocess.run([installed / "gss", "--version"], cwd=tmp_path, capture_output=True, text=True, check=True)
    assert gss.__version__ in version.stdout
    print_location = [installed / "python", "-c", "import gss; print(gss.__file__)"]
    assert subprocess.run(print_location, cwd=tmp_path, capture_output=True, text=True).stdout.startswith(
        str(installed.parent)
    )


def test_the_wheel_solves_and_simulates_without_a_checkout(installed: Path, tmp_path: Path) -> None:
    """``gss solve`` finds a rendered frame's attitude and ``gss simulate`` opens its port, from an empty folder and without make
    or node on the path."""
    camera = shipped_camera("cubestar")
    stars = SolverCache().stars(2025.0).brighter_than(4.5)
    pointing = cam_from_icrs(np.radians(80.2), 0.0, 1.0)
    frame = render(stars, camera.camera, camera.sensor, pointing, camera.sensor.exposure_s, np.random.default_rng(1))
    Image.fromarray(frame.pixels).save(tmp_path / "frame.png")
    environment = {"PATH": str(installed), "HOME": str(tmp_path)}
    solve = [str(installed / "gss"), "solve", "frame.png", "--camera", "cubestar", "--json"]
    solved = subprocess.run(solve, cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=300)
    assert solved.returncode == 0, solved.stderr
    assert abs(json.loads(solved.stdout)["ra_deg"] - 80.2) < 0.5
    command = [str(installed / "gss"), "simulate", "--tcp", "0", "--exit-with-stdin"]
    with subprocess.Popen(
        command, cwd=tmp_path, env=environment, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as child:
        assert child.stdout is not None
        assert child.stdout.readline().startswith("READY socket://127.0.0.1:")
        assert child.stdin is not None
        child.stdin.close()
        assert child.wait(timeout=60) == 0


def get(address: str) -> tuple[int, str, bytes]:
    """Return status, content type and body."""
    try:
        with urllib.request.urlopen(address, timeout=30) as response:  # noqa: S310  # our own server
            return response.status, response.headers["Content-Type"], response.read()
    except urllib.error.HTTPError as error:
        return error.code, error.headers["Content-Type"], error.read()


def test_the_first_start_from_the_wheel_shows_set_up_pages_and_documents(served: tuple[str, Path]) -> None:
    """At the first start the server prints its address, allows set-up, and serves pages and documents.

    All else requires signing in.
    """
    line, _ = served
    base = re.search(r"http://[\w.\[\]:]+", line)[0]
    assert "/setup#" in line
    status, kind, page = get(f"{base}/setup")
    assert (status, kind.split(";")[0]) == (200, "text/html")
    files = re.findall(r'(?:src|href)="(/assets/[^"]+)"', page.decode())
    assert files
    assert all(get(base + file)[0] == 200 for file in files)
    assert b'"set_up_needed":true' in get(f"{base}/api/session")[2].replace(b" ", b"")
    assert get(f"{base}/api/frames")[0] == 401
    assert [get(base + path)[0] for path in ("/help", "/help/operator", "/help/pictures/live.png")] == [200, 200, 200]


def test_the_wheel_brings_the_database_to_the_newest_schema(root: Path, served: tuple[str, Path]) -> None:
    """A new database has the newest migration of the tree."""
    scripts = [p.read_text() for p in (root / "migrations" / "versions").glob("*.py")]
    revisions = {re.search(r'^revision(?:: str)? = "(\w+)"', text, re.MULTILINE)[1] for text in scripts}
    superseded = {re.search(r'^down_revision.*?= (?:"(\w+)"|None)', text, re.MULTILINE)[1] for text in scripts}
    with sqlite3.connect(served[1] / "gss.db") as database:
        assert {row[0] for row in database.execute("select version_num from alembic_version")} == revisions - superseded
