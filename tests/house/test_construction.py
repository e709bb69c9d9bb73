"""Objects are complete when their constructor returns: no code assigns a function to an attribute of another
object, and the wiring's records are frozen.
"""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

LIBRARY_DOORS = {
    "gss/api/errors.py": "FastAPI's way to change the schema is to replace the application's function",
    "gss/catalogue_tools/sources/star_list_guards.py": "expat takes its handlers as attributes",
    "gss/instruments/dictionary/xml_lines.py": "expat takes its handlers as attributes",
}


def _functions(tree: ast.Module) -> set[str]:
    """Return names of functions, without methods, and of arguments that are functions."""
    methods = {m for node in ast.walk(tree) if isinstance(node, ast.ClassDef) for m in node.body}
    defs = [node for node in ast.walk(tree) if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)]
    arguments = [a for node in defs for a in (*node.args.args, *node.args.kwonlyargs) if a.annotation]
    return {node.name for node in defs if node not in methods} | {
        a.arg for a in arguments if "Callable" in ast.unparse(a.annotation)
    }


def _is_own(owner: ast.expr) -> bool:
    """True for the object of a method."""
    return isinstance(owner, ast.Name) and owner.id in ("self", "cls")


def _assigned(tree: ast.Module) -> Iterator[tuple[ast.Attribute, ast.expr]]:
    """Yield each attribute of an object other than ``self`` that is assigned, with its value."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Assign | ast.AugAssign):
            for target in node.targets if isinstance(node, ast.Assign) else [node.target]:
                parts = target.elts if isinstance(target, ast.Tuple) else [target]
                values = node.value.elts if isinstance(node.value, ast.Tuple) else [node.value] * len(parts)
                for part, value in zip(parts, values, strict=False):
                    if isinstance(part, ast.Attribute) and not _is_own(part.value):
                        yield part, value


def test_no_function_is_set_from_outside(root: Path) -> None:
    """No code assigns a function to an attribute of another object; hooks are constructor arguments."""
    hooks = []
    for path in sorted((root / "gss").rglob("*.py")):
        if (name := path.relative_to(root).as_posix()) not in LIBRARY_DOORS:
            tree = ast.parse(path.read_text("utf-8"))
            assigned = list(_assigned(tree))
            functions = _functions(tree) if assigned else set()
            hooks += [
                f"{name}:{target.lineno}: {ast.unparse(target)} = {ast.unparse(value)}"
                for target, value in assigned
                if isinstance(value, ast.Lambda) or (isinstance(value, ast.Name) and value.id in functions)
            ]
    assert not hooks, "\n".join(hooks)


def test_the_rooms_are_frozen(root: Path) -> None:
    """Records of the wiring are frozen dataclasses, and the wiring assigns no attribute."""
    for path in sorted((root / "gss" / "wiring").glob("*.py")):
        tree = ast.parse(path.read_text("utf-8"))
        assert not list(_assigned(tree)), path
        for node in tree.body:
            if isinstance(node, ast.ClassDef):
                assert [ast.unparse(d) for d in node.decorator_list] == ["dataclass(frozen=True)"], node.name
