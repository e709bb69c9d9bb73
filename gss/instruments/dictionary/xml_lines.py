"""Parse XML with line numbers. Document types, entities and external references are rejected; size and depth are
limited."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any
from xml.parsers import expat

from gss.domain.errors import BadInput

MAX_BYTES = 4 << 20
MAX_ELEMENTS = 200_000
DEEPEST = 40


@dataclass(frozen=True)
class Element:
    """One element. ``tag``: name without namespace. ``line``: line of the start tag, counted from 1. ``text``: text
    directly in the element."""

    file: str
    tag: str
    line: int
    attributes: Mapping[str, str]
    children: list[Element] = field(default_factory=list)
    texts: list[str] = field(default_factory=list)

    @property
    def text(self) -> str:
        """Text directly in the element."""
        return "".join(self.texts)

    def error(self, reason: str, *, expected: str = "", got: str = "") -> BadInput:
        """Return an error about this element, with file, line and the element's name."""
        name = f" name={self.attributes['name']}" if "name" in self.attributes else ""
        return BadInput(f"{self.file}, line {self.line}: {self.tag}{name}: {reason}", expected=expected, got=got)

    def checked(self, children: str = "", attributes: str = "") -> Element:
        """Return this element. Raises BadInput if it has children or attributes with other names than these."""
        allowed = children.split()
        for child in self.children:
            if child.tag not in allowed:
                raise child.error(f"is not supported in {self.tag}", expected=children or "no element")
        unknown = sorted(set(self.attributes) - set(attributes.split()))
        if unknown:
            raise self.error(f"the attribute {unknown[0]} is not supported", expected=attributes or "no attribute")
        return self

    def child(self, tag: str) -> Element | None:
        """Return the only child with a tag, or None. Raises BadInput if there are several."""
        children = self.all(tag)
        if len(children) > 1:
            raise children[1].error("appears twice")
        return children[0] if children else None

    def need(self, tag: str) -> Element:
        """Return the only child with a tag. Raises BadInput if there is none."""
        child = self.child(tag)
        if child is None:
            raise self.error(f"has no {tag}")
        return child

    def all(self, tag: str) -> list[Element]:
        """Return the children with a tag."""
        return [child for child in self.children if child.tag == tag]

    def rows(self, *tags: str) -> Iterator[Element]:
        """Yield the grandchildren whose parents have these tags."""
        for tag in tags:
            child = self.child(tag)
            if child is not None:
                yield from child.children

    def get(self, attribute: str) -> str:
        """Return an attribute. Raises BadInput if it is missing."""
        if attribute not in self.attributes:
            raise self.error(f"the attribute {attribute} is missing")
        return self.attributes[attribute]

    def integer(self, text: str) -> int:
        """Convert a text of this element to an integer. Raises BadInput."""
        try:
            return int(text) if len(text) < 30 else int("")
        except ValueError:
            raise self.error("not an integer", got=text[:60]) from None

    def number(self, text: str) -> int | float:
        """Convert a text of this element to a finite number; integers are exact. Raises BadInput."""
        try:
            value = float(text)
        except ValueError:
            value = float("nan")
        if value - value != 0 or len(text) > 60:
            raise self.error("not a finite number", got=text[:60])
        return int(text) if text.strip().lstrip("+-").isdecimal() else value


def parse_xml(file: str, data: bytes, namespaces: str) -> Element:
    """Return the root element. ``namespaces``: required start of every element's namespace. Raises BadInput with file
    and line."""
    if len(data) > MAX_BYTES:
        raise BadInput(f"{file} is too large", expected=f"at most {MAX_BYTES} bytes", got=str(len(data)))
    parser = expat.ParserCreate(namespace_separator=" ")
    roots: list[Element] = []
    path: list[Element] = []
    count = 0

    def line(reason: str, **facts: str) -> BadInput:
        return BadInput(f"{file}, line {parser.CurrentLineNumber}: {reason}", **facts)

    def doctype(*_: Any) -> None:
        raise line("document types and entities are not accepted", expected="elements and text only")

    def start(name: str, attributes: dict[str, str]) -> None:
        nonlocal count
        count += 1
        namespace, _, tag = name.rpartition(" ")
        if count > MAX_ELEMENTS or len(path) >= DEEPEST:
            raise line(
                "too many elements, or elements nested too deeply",
                expected=f"{MAX_ELEMENTS} elements, {DEEPEST} levels",
            )
        if not namespace.startswith(namespaces):
            raise line(
                f"{tag} is not in a supported namespace", expected=f"{namespaces}… (1.2 or later)", got=namespace[:100]
            )
        # Attributes of other namespaces, such as xsi:schemaLocation, describe the document and not the interface.
        plain = {key: value for key, value in attributes.items() if " " not in key}
        element = Element(file, tag, parser.CurrentLineNumber, plain)
        (path[-1].children if path else roots).append(element)
        path.append(element)

    parser.StartDoctypeDeclHandler = doctype
    parser.EntityDeclHandler = doctype
    parser.StartElementHandler = start
    parser.EndElementHandler = lambda _: path.pop()
    parser.CharacterDataHandler = lambda text: path[-1].texts.append(text)
    try:
        parser.Parse(data, True)
    except expat.ExpatError as error:
        raise BadInput(f"{file}, line {error.lineno}: not XML: {expat.ErrorString(error.code)}") from None
    except (ValueError, LookupError) as error:
        raise BadInput(f"{file} is not XML", got=str(error)[:200]) from None
    return roots[0]
