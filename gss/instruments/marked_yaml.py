"""YAML with line numbers: a parsed file together with the line of each field.

Stricter than YAML 1.1: no aliases (a few bytes could expand to gigabytes), no duplicate keys, no dates, no tags for
other types. As in YAML 1.2, ``1e-4`` is a float, and only ``true`` and ``false`` are booleans: ``on``, ``off``, ``yes``,
``no`` and ``22:00`` are text.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

import yaml

from gss.domain.errors import BadInput

MAX_BYTES = 1 << 20
DEEPEST = 20
BASE: type[yaml.SafeLoader] = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
BOOL = "tag:yaml.org,2002:bool"
TAGS = (BOOL, *(f"tag:yaml.org,2002:{kind}" for kind in ("null", "int", "float", "str", "seq", "map")))
FLOAT = re.compile(r"^[-+]?(?:[0-9]+(?:\.[0-9]*)?|\.[0-9]+)[eE][-+]?[0-9]+$")
SEXAGESIMAL = re.compile(r"^[-+]?[0-9][0-9_]*(?::[0-5]?[0-9])+(?:\.[0-9_]*)?$")
Place = tuple[str | int, ...]


class _Loader(BASE):  # type: ignore[misc, valid-type]  # chosen at import: libyaml where it was built in
    """YAML loader for plain data, without dates."""


_Loader.yaml_implicit_resolvers = {
    first: [
        ("tag:yaml.org,2002:str", SEXAGESIMAL),  # before the numbers, because the first pattern that matches is used
        *((tag, pattern) for tag, pattern in resolvers if tag not in ("tag:yaml.org,2002:timestamp", BOOL)),
    ]
    for first, resolvers in BASE.yaml_implicit_resolvers.items()
}
_Loader.add_implicit_resolver(BOOL, re.compile(r"^(?:true|True|TRUE|false|False|FALSE)$"), list("tTfF"))
_Loader.add_implicit_resolver("tag:yaml.org,2002:float", FLOAT, list("-+.0123456789"))


@dataclass(frozen=True)
class MarkedYaml:
    """Content of one file. ``lines``: line number, counted from 1, of each key and list entry, by path."""

    name: str
    content: object
    lines: dict[Place, int]

    def line(self, path: Sequence[str | int]) -> int:
        """Return the line of the deepest part of ``path`` in the file. Parts that are not in the file, such as the name
        of a variant, are skipped."""
        at: Place = ()
        for part in path:
            if (*at, part) in self.lines:
                at = (*at, part)
        return self.lines.get(at, 1)

    def error(self, path: Sequence[str | int], reason: str, got: str = "") -> BadInput:
        """Return an error about a field, with file, line, field and reason."""
        place = ".".join(str(part) for part in path) or "the file"
        return BadInput(f"{self.name}, line {self.line(path)}: {place}: {reason}", got=got)


def parse_yaml(name: str, data: bytes) -> MarkedYaml:
    """Parse one file. Raises BadInput with file and line."""
    if len(data) > MAX_BYTES:
        raise BadInput(f"{name} is too large", expected=f"at most {MAX_BYTES} bytes", got=str(len(data)))
    try:
        text = data.decode("utf-8")
    except UnicodeDecodeError as error:
        raise BadInput(f"{name} is not UTF-8 text", got=str(error)) from None
    try:
        loader = _Loader(text)
        try:
            node = loader.get_single_node()
            lines: dict[Place, int] = {}
            if node is not None:
                _mark(name, node, (), lines, set())
            content = loader.construct_document(node) if node is not None else None
        finally:
            loader.dispose()
    except yaml.MarkedYAMLError as error:
        line = error.problem_mark.line + 1 if error.problem_mark else 1
        raise BadInput(f"{name}, line {line}: not YAML: {error.problem or error.context}") from None
    except (yaml.YAMLError, ValueError, TypeError, OverflowError, RecursionError) as error:
        raise BadInput(f"{name} is not YAML", got=str(error)[:300] or type(error).__name__) from None
    return MarkedYaml(name, content, lines)


def _mark(name: str, node: yaml.Node, path: Place, lines: dict[Place, int], visited: set[int]) -> None:
    line = node.start_mark.line + 1
    lines.setdefault(path, line)
    if id(node) in visited:
        raise BadInput(f"{name}, line {line}: aliases (*) are not supported; write the value again")
    visited.add(id(node))
    if node.tag not in TAGS:
        raise BadInput(f"{name}, line {line}: this tag is not supported", expected="a value without tag", got=node.tag)
    if len(path) > DEEPEST:
        raise BadInput(f"{name}, line {line}: nested more than {DEEPEST} levels deep")
    if isinstance(node, yaml.SequenceNode):
        for index, entry in enumerate(node.value):
            _mark(name, entry, (*path, index), lines, visited)
    elif isinstance(node, yaml.MappingNode):
        _mark_mapping(name, node, path, lines, visited)


def _mark_mapping(name: str, node: yaml.MappingNode, path: Place, lines: dict[Place, int], visited: set[int]) -> None:
    for key, value in node.value:
        line = key.start_mark.line + 1
        if not isinstance(key, yaml.ScalarNode) or key.tag != "tag:yaml.org,2002:str":
            raise BadInput(f"{name}, line {line}: a key must be plain text")
        if (*path, key.value) in lines:
            raise BadInput(f"{name}, line {line}: {key.value} appears twice")
        lines[*path, key.value] = line
        _mark(name, value, (*path, key.value), lines, visited)
