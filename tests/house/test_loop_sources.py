"""Compiled loops are stored in a folder whose name depends on the sources they use, so all these sources must be known."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

from gss.pipeline import kernels

PACKAGE = Path(kernels.__file__).parents[1]


def imports(module: Path) -> list[tuple[Path, list[str]]]:
    """Return the modules of GSS from which a module imports, with the imported names."""
    found = []
    for node in ast.parse(module.read_text("utf-8")).body:
        if isinstance(node, ast.ImportFrom) and node.module and node.module.startswith("gss."):
            source = PACKAGE.joinpath(*node.module.split(".")[1:]).with_suffix(".py")
            found.append((source, [alias.name for alias in node.names]))
    return found


def constants(module: Path) -> dict[str, ast.expr]:
    """Return the constants that a module assigns, one by one or as a tuple."""
    found: dict[str, ast.expr] = {}
    for node in ast.parse(module.read_text("utf-8")).body:
        if isinstance(node, ast.Assign):
            target = node.targets[0]
            names = target.elts if isinstance(target, ast.Tuple) else [target]
            found |= {name.id: node.value for name in names if isinstance(name, ast.Name)}
    return found


@pytest.mark.parametrize("loops", sorted(kernels.LOOPS.glob("*.py")), ids=lambda path: path.stem)
def test_constants_of_loops_are_numbers_of_known_modules(loops: Path) -> None:
    """Each module from which the loops import belongs to the sources. Its constants are computed from its own numbers,
    because a change in a third module would not be noticed.
    """
    known = kernels._sources()
    for module, names in imports(loops):
        if kernels.LOOPS in (module.parent, module.with_suffix("")):
            continue  # all files of the loops are known
        assert module in known, f"{loops.name} imports from {module}, which is not a known source"
        own = constants(module)
        for name in (n for n in names if n.isupper()):
            assert name in own, f"{name} is not assigned in {module}"
            used = {node.id for node in ast.walk(own[name]) if isinstance(node, ast.Name)}
            assert used - {"np"} <= own.keys(), f"{name} in {module} uses {used - own.keys()}"


def test_the_folder_changes_with_a_constant(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """The folder of the compiled loops has another name after a constant of another module changed."""
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    changed = tmp_path / "background.py"
    source = PACKAGE / "pipeline" / "background.py"
    changed.write_text(source.read_text("utf-8").replace("CLIP_SIGMA = 3.0", "CLIP_SIGMA = 1.5"), "utf-8")
    sources = kernels._sources()
    folders = []
    for replacement in (source, changed, source):
        monkeypatch.setattr(kernels, "_sources", lambda: [replacement if s == source else s for s in sources])  # noqa: B023
        kernels.cache_folder.cache_clear()
        folders.append(kernels.cache_folder())
    kernels.cache_folder.cache_clear()
    assert source in sources
    assert folders[0] == folders[2] != folders[1]
