"""Convert the containers of an XTCE document to rows: telemetry packets, events, service messages and values that
commands return."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, field

from gss.instruments.dictionary import xtce_terms as terms
from gss.instruments.dictionary.xml_lines import Element
from gss.instruments.dictionary.xtce_values import (
    COMMON_ATTRIBUTES,
    COMMON_CHILDREN,
    Row,
    Size,
    TypeReader,
    descriptions,
    facts_of,
)

CONTAINER_FACTS = (
    f"{terms.ROLE} code stale_after_s simulator_only packet command severity action list slots count purpose"
)
FIELD_FACTS = f"{terms.ROLE} page decimals stale_after_s persistence sets action watch warning critical valid rows"
ROOM_OF_TEXT = 8
EQUAL = "=="
INNER_LIST = "a list inside a list is not supported"
ROLES = (terms.HEADER, terms.TELEMETRY, terms.EVENT, terms.SERVICE, terms.RETURNS, terms.STAGE, terms.ROW)


@dataclass(frozen=True)
class ContainerRows:
    """Rows of each section, with their line numbers."""

    telemetry: list[Row] = field(default_factory=list)
    events: list[Row] = field(default_factory=list)
    services: list[Row] = field(default_factory=list)
    lines: dict[str, list[int]] = field(default_factory=lambda: {"telemetry": [], "events": [], "services": []})


class Containers:
    """The containers and parameters of ``TelemetryMetaData``. ``returns``: values that a completed command returns, by
    command name."""

    def __init__(self, telemetry: Element | None, values: TypeReader) -> None:
        self._values = values
        self._parameters = _by_name(telemetry, "ParameterSet", "Parameter")
        self._containers = _by_name(telemetry, "ContainerSet", "SequenceContainer")
        self._facts = {name: facts_of(c, CONTAINER_FACTS) for name, c in self._containers.items()}
        self.returns: dict[str, list[Row]] = {}
        self._return_containers: dict[str, Element] = {}
        self._housekeeping: dict[str, Row] = {}

    def rows(self) -> ContainerRows:
        """Return the rows of all packets in the order of the document."""
        rows = ContainerRows()
        inner = {facts["rows"] for p in self._parameters.values() if "rows" in (facts := facts_of(p, FIELD_FACTS))}
        inner |= {
            entry.get("containerRef")
            for c in self._containers.values()
            for entry in c.need("EntryList").all("ContainerRefEntry")
        }
        for name, container in self._containers.items():
            container.checked(f"{COMMON_CHILDREN} EntryList BaseContainer", f"{COMMON_ATTRIBUTES} abstract")
            role = self._role(name, container, inner)
            if role in (terms.TELEMETRY, terms.EVENT, terms.SERVICE, terms.RETURNS):
                self._check_bases(container)
            if role == terms.TELEMETRY:
                row = self._telemetry(name, container)
                rows.telemetry.append(row)
                rows.lines["telemetry"].append(container.line)
            elif role == terms.SERVICE:
                rows.services.append(self._service(name, container))
                rows.lines["services"].append(container.line)
            elif role == terms.EVENT:
                rows.events.append(self._event(name, container))
                rows.lines["events"].append(container.line)
            elif role == terms.RETURNS:
                command = str(self._facts[name].get("command", ""))
                self.returns[command] = self._fields(command, container, telemetry=False)
                self._return_containers[command] = container
            elif role == terms.ROW and name not in inner:
                raise container.error(
                    "describes rows that no list contains", expected="a list that names this container"
                )
        return rows

    def check_returns(self, commands: Collection[str]) -> None:
        """Raise BadInput if there are return values of an unknown command."""
        for command, container in self._return_containers.items():
            if command not in commands:
                raise container.error(
                    "has the values of an unknown command", expected="a MetaCommand of this name", got=command[:80]
                )

    def is_checksum(self, parameter: str) -> bool:
        """True if the parameter is the checksum after the content."""
        element = self._parameters.get(parameter)
        return element is not None and facts_of(element, FIELD_FACTS).get(terms.ROLE) == terms.CHECKSUM

    def housekeeping(self, parameter: str) -> Row | None:
        """Return the row of a parameter in the packet ``housekeeping``; None if the packet does not contain it."""
        return self._housekeeping.get(parameter)

    # --- packets ------------------------------------------------------------------------------------------------------

    def _role(self, name: str, container: Element, inner: set[str]) -> str:
        stated = self._facts[name].get(terms.ROLE)
        if stated is not None:
            if stated not in ROLES:
                raise container.error("unknown role of a container", expected=", ".join(ROLES), got=str(stated)[:40])
            return str(stated)
        if name in inner:
            return terms.ROW
        if container.attributes.get("abstract") in ("true", "1"):
            return terms.HEADER
        derived = [c for c in self._containers.values() if _base(c) == name]
        if derived:
            raise container.error("is the base of another container and not abstract", got=derived[0].get("name")[:80])
        return terms.TELEMETRY

    def _check_bases(self, container: Element) -> None:
        """Raise BadInput if a base between packet and header has content."""
        name, depth = _base(container), 0
        while name:
            base = self._containers.get(name)
            depth += 1
            if base is None or depth > 20:
                raise container.error("has an unknown base, or its bases form a circle", got=name[:80])
            above = _base(base)
            marked = self._facts[name].get(terms.ROLE) in (terms.HEADER, terms.SERVICE)
            if above and base.need("EntryList").children and not marked:
                raise base.error(
                    "entries between packet and header are not supported",
                    expected='them in the packet, or AncillaryData gss with {"role_of_container": "header"}',
                )
            name = above

    def _telemetry(self, name: str, container: Element) -> Row:
        facts = self._facts[name]
        short, long = descriptions(container)
        row: Row = {"name": name, "code": self._code(name, container), "purpose": long or short or name}
        row["stale_after_s"] = facts.get("stale_after_s", 0.0)
        row |= {key: facts[key] for key in ("simulator_only",) if key in facts}
        row["fields"] = self._fields(name, container, telemetry=True)
        if name == "housekeeping":
            self._housekeeping = {f"{name}_{f['name']}": f for f in row["fields"] if "type" in f}
        return row

    def _service(self, name: str, container: Element) -> Row:
        row: Row = {"name": name, "packet": self._facts[name].get("packet"), "purpose": descriptions(container)[0]}
        row["code"] = self._facts[name].get("code", 0)
        return row | {"fields": self._fields(name, container, telemetry=False)}

    def _event(self, name: str, container: Element) -> Row:
        facts = self._facts[name]
        row = {"name": name.removeprefix("EVENT_"), "code": self._code(name, container)}
        row |= {"purpose": descriptions(container)[0], "severity": facts.get("severity")}
        return row | ({"action": facts["action"]} if "action" in facts else {})

    def _code(self, name: str, container: Element) -> int:
        """Return the code of a packet: the stated code, the value compared with CODE, or the value of the only
        comparison."""
        if "code" in self._facts[name]:
            return container.integer(str(self._facts[name]["code"]))
        base = container.child("BaseContainer")
        criteria = base.checked("RestrictionCriteria", "containerRef").child("RestrictionCriteria") if base else None
        if criteria is None:
            raise container.error(
                "has no code", expected="a Comparison in its BaseContainer, or code in AncillaryData gss"
            )
        criteria.checked("Comparison ComparisonList")
        comparisons = [*criteria.all("Comparison"), *criteria.rows("ComparisonList")]
        for comparison in comparisons:
            if comparison.tag != "Comparison":
                raise comparison.error("is not supported", expected="Comparison")
            comparison.checked("", "parameterRef comparisonOperator value useCalibratedValue")
            if comparison.attributes.get("comparisonOperator", EQUAL) != EQUAL:
                raise comparison.error("only comparisons with == select a packet")
        chosen = [c for c in comparisons if c.get("parameterRef") == "CODE"] or comparisons
        if len(chosen) != 1:
            raise criteria.error(
                "more than one comparison and none with CODE: the code is ambiguous",
                expected="a comparison with CODE, or code in AncillaryData gss",
            )
        return chosen[0].integer(chosen[0].get("value"))

    # --- fields -------------------------------------------------------------------------------------------------------

    def _fields(self, owner: str, container: Element, *, telemetry: bool, is_row: bool = False) -> list[Row]:
        """Return the values and lists of a container in their order. ``is_row``: True for a row of a list, which can
        contain only values."""
        entries = container.need("EntryList").children
        fields: list[Row] = []
        for at, entry in enumerate(entries):
            if entry.tag == "ContainerRefEntry" and is_row:
                raise entry.error(INNER_LIST)
            if entry.tag == "ContainerRefEntry":
                fields[-1:] = [self._repeated(owner, entry, fields[-1] if fields else {})]
                continue
            if entry.tag != "ParameterRefEntry":
                raise entry.error("is not supported in a container", expected="ParameterRefEntry, ContainerRefEntry")
            parameter = self._parameter(entry)
            facts = facts_of(parameter, FIELD_FACTS)
            if facts.pop(terms.ROLE, None) == terms.CHECKSUM:
                if at != len(entries) - 1:
                    raise entry.error("a checksum is the last entry")
                continue
            rows = facts.pop("rows", None)
            row, size = self._values.row(parameter, facts)
            row["name"] = parameter.get("name").removeprefix(f"{owner}_")
            self._describe(parameter, row, telemetry)
            if rows is not None and is_row:
                raise entry.error(INNER_LIST)
            if rows is not None:
                self._drop_count(entry, fields, size.parameter if size else "", owner)
                row = self._list(parameter, row["name"], str(rows), fields.pop())
            elif row["type"] == "text":
                if size is None or (size.slope, size.intercept) != (8, 0):
                    raise parameter.error("the size of a text must be 8 times the parameter before it")
                self._drop_count(entry, fields, size.parameter, owner)
                if fields.pop()["type"] != "u8":
                    raise parameter.error("the length of a text must be an unsigned integer of 8 bits")
            elif row["type"] == "rest" and (at < len(entries) - 2 or not self._to_the_end(size)):
                raise parameter.error("a value of variable size must be the last one and end with the packet")
            fields.append(row)
        return fields

    @staticmethod
    def _to_the_end(size: Size | None) -> bool:
        return size is not None and size.parameter == "PKT_LEN" and size.slope == ROOM_OF_TEXT

    @staticmethod
    def _drop_count(entry: Element, fields: list[Row], parameter: str, owner: str) -> None:
        """Raise BadInput unless the previous entry is the number that states the size."""
        last = fields[-1]["name"] if fields and "type" in fields[-1] else ""
        if not last or (parameter and parameter.removeprefix(f"{owner}_") != last):
            raise entry.error("its count or length must be the entry directly before it")

    def _parameter(self, entry: Element) -> Element:
        name = entry.checked("", "parameterRef").get("parameterRef")
        if name not in self._parameters:
            raise entry.error(f"unknown parameter {name}"[:120])
        return self._parameters[name].checked(COMMON_CHILDREN, f"{COMMON_ATTRIBUTES} parameterTypeRef initialValue")

    @staticmethod
    def _describe(parameter: Element, row: Row, telemetry: bool) -> None:
        short, long = descriptions(parameter)
        if telemetry:
            row |= ({"title": short} if short else {}) | ({"purpose": long} if long else {})
        elif long or short:
            row["purpose"] = long or short

    def _list(self, parameter: Element, name: str, row_name: str, count: Row) -> Row:
        """Return a list that is exported as bytes. A separate container describes a row of the list."""
        container = self._containers.get(row_name)
        if container is None:
            raise parameter.error(f"unknown container of rows {row_name}"[:120])
        facts = self._facts[row_name]
        row: Row = {
            "name": facts.get("list", name),
            "list": self._fields(row_name, container, telemetry=False, is_row=True),
        }
        return row | {"count": count["type"]} | {k: facts[k] for k in ("slots", "purpose") if k in facts}

    def _repeated(self, owner: str, entry: Element, count: Row) -> Row:
        """Return a list that is exported as a repeated container. The number before the container is the count."""
        repeat = entry.checked("RepeatEntry", "containerRef").need("RepeatEntry").checked("Count").need("Count")
        name = entry.get("containerRef")
        container = self._containers.get(name)
        if container is None:
            raise entry.error(f"unknown container {name}"[:120])
        fixed, dynamic = repeat.checked("FixedValue DynamicValue").child("FixedValue"), repeat.child("DynamicValue")
        reference = ""
        if dynamic is not None:
            reference = dynamic.checked("ParameterInstanceRef").need("ParameterInstanceRef").get("parameterRef")
        if (fixed is None) == (dynamic is None):
            raise repeat.error("needs FixedValue or DynamicValue")
        self._drop_count(entry, [count] if count else [], reference, owner)
        facts = self._facts[name]
        plain = name.removeprefix(f"{owner}_").removesuffix("_row")
        row: Row = {
            "name": facts.get("list", plain),
            "list": self._fields(name, container, telemetry=False, is_row=True),
        }
        if fixed is not None:
            row["slots"] = fixed.integer(fixed.text.strip())
        return row | {"count": count["type"]} | {k: facts[k] for k in ("purpose",) if k in facts}


def _base(container: Element) -> str:
    base = container.child("BaseContainer")
    return base.get("containerRef") if base is not None else ""


def _by_name(telemetry: Element | None, part: str, tag: str) -> dict[str, Element]:
    elements: dict[str, Element] = {}
    for element in telemetry.rows(part) if telemetry is not None else ():
        if element.tag != tag:
            raise element.error(f"is not supported in {part}", expected=tag)
        if elements.setdefault(element.get("name"), element) is not element:
            raise element.error("appears twice")
    return elements
