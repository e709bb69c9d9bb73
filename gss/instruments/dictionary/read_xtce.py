"""Read a dictionary from XTCE 1.2 or later, as an alternative to ``dictionary.yaml``.

The document is converted to the rows of the YAML file, which the same code checks. A document from ``gss export xtce``
thus gives an equal dictionary. An unsupported construct is rejected with its name and line; no construct is skipped.
Packet headers are not part of a dictionary: containers without a base, and containers marked as header, represent the
header that ``link.yaml`` or the driver describes. A comparison states the code of a packet.
"""

from __future__ import annotations

from dataclasses import dataclass
from decimal import Decimal, InvalidOperation
from typing import Any

from gss.domain.errors import BadInput
from gss.instruments.dictionary.definitions import Dictionary
from gss.instruments.dictionary.read_dictionary import WRONG_ROW, layout_hash, read_content
from gss.instruments.dictionary.xml_lines import Element, parse_xml
from gss.instruments.dictionary.xtce_containers import Containers
from gss.instruments.dictionary.xtce_terms import ANCILLARY, FAMILY, LEVELS, LITTLE_ENDIAN, OPERATORS
from gss.instruments.dictionary.xtce_values import (
    COMMON_ATTRIBUTES,
    COMMON_CHILDREN,
    Row,
    TypeReader,
    descriptions,
    facts_of,
)
from gss.instruments.marked_yaml import MarkedYaml, Place

ACCEPT_S, COMPLETE_S = 5.0, 30.0
"""Default time limits of commands without verifiers in the document."""
SUBSYSTEM = "processor"
"""Default subsystem of commands without a subsystem in the document. It determines which users can send them."""
COMMAND_FACTS = (
    "code subsystem role favourite idempotent any_dictionary simulator_only accept_s complete_s hazard_reason "
    "precondition_texts"
)
ARGUMENT_FACTS = "min max choice_hazards"
HAZARDS = {level: str(hazard) for hazard, level in LEVELS.items()} | {"normal": "none"}


@dataclass(frozen=True)
class XtceDictionary:
    """A dictionary and the byte order of its numbers: big, little, or None if no number has more than one byte."""

    dictionary: Dictionary
    byte_order: str | None


def read_xtce(name: str, data: bytes) -> XtceDictionary:
    """Return the dictionary in an XTCE document. Raises BadInput naming file, line and element."""
    root = parse_xml(name, data, FAMILY)
    if root.tag != "SpaceSystem":
        raise root.error("is not the root of an XTCE document", expected="SpaceSystem")
    try:
        return _XtceReader(root).dictionary()
    except (*WRONG_ROW, ArithmeticError) as error:
        raise root.error("a value has a wrong type", got=f"{type(error).__name__}: {error}"[:200]) from error


class _XtceReader:
    """Converts a document to rows and stores the line of each row."""

    def __init__(self, root: Element) -> None:
        self._root = root.checked(
            f"{COMMON_CHILDREN} Header TelemetryMetaData CommandMetaData", f"{COMMON_ATTRIBUTES} operationalStatus"
        )
        self._facts = facts_of(root, "layout hash same_layout_as limit_sets")
        self._enums: dict[str, list[Row]] = {}
        self._orders: set[str] = set()
        self._lines: dict[Place, int] = {(): root.line}
        telemetry = root.child("TelemetryMetaData")
        if telemetry is not None:
            telemetry.checked("ParameterTypeSet ParameterSet ContainerSet")
        values = TypeReader(
            telemetry.rows("ParameterTypeSet") if telemetry else (), "Parameter", self._enums, self._orders
        )
        self._containers = Containers(telemetry, values)
        self._command_part = part = root.child("CommandMetaData")
        if part is not None:
            part.checked("ArgumentTypeSet MetaCommandSet")
        self._arguments = TypeReader(
            part.rows("ArgumentTypeSet") if part else (), "Argument", self._enums, self._orders
        )

    def dictionary(self) -> XtceDictionary:
        """Return the dictionary after all checks."""
        rows = self._containers.rows()
        content: Row = {
            "version": self._version(),
            "device_model": self._root.get("name"),
            "enums": self._enums,
            "commands": self._commands(),
            "telemetry": rows.telemetry,
            "events": rows.events,
            "services": rows.services,
        }
        self._containers.check_returns([command["name"] for command in content["commands"]])
        for section in ("telemetry", "events", "services"):
            self._lines |= {(section, k): line for k, line in enumerate(rows.lines[section])}
        for key in ("limit_sets", "same_layout_as"):
            if key in self._facts:
                content[key] = self._facts[key]
        # If the document was edited, the stated hash is that of the original layout and does not apply.
        layout = layout_hash({key: value for key, value in content.items() if key != "same_layout_as"})
        stated = self._facts.get("layout") == layout.hex()
        if not stated:
            content.pop("same_layout_as", None)
        file = MarkedYaml(self._root.file, content, self._lines)
        dictionary = read_content(file, self._stated_hash() if stated else layout)
        orders = {"little" if order == LITTLE_ENDIAN else "big" for order in self._orders}
        return XtceDictionary(dictionary, next(iter(orders), None))

    def _stated_hash(self) -> bytes:
        try:
            stated = bytes.fromhex(self._facts["hash"])
        except (KeyError, TypeError, ValueError):
            stated = b""
        if len(stated) != 32:
            raise self._root.error(f"AncillaryData {ANCILLARY}: hash is not a SHA-256 in hexadecimal digits")
        return stated

    def _version(self) -> int:
        """Return the integer part of the header's version; 1 without a version."""
        header = self._root.child("Header")
        text = header.attributes.get("version", "") if header else ""
        major = text.partition(".")[0]
        return int(major) if major.isdecimal() and len(major) < 10 else 1

    # --- commands -----------------------------------------------------------------------------------------------------

    def _commands(self) -> list[Row]:
        part = self._command_part
        if part is None:
            return []
        commands = {command.get("name"): command for command in part.rows("MetaCommandSet")}
        rows: list[Row] = []
        for command in part.rows("MetaCommandSet"):
            if command.tag != "MetaCommand":
                raise command.error("is not supported in MetaCommandSet", expected="MetaCommand")
            if command.attributes.get("abstract") in ("true", "1"):
                if command.child("BaseMetaCommand") is not None:
                    raise command.error("an abstract command with a base is not supported")
                continue
            self._lines["commands", len(rows)] = command.line
            rows.append(self._command(command, commands))
        return rows

    def _command(self, command: Element, commands: dict[str, Element]) -> Row:
        command.checked(
            f"{COMMON_CHILDREN} BaseMetaCommand ArgumentList CommandContainer "
            "TransmissionConstraintList DefaultSignificance VerifierSet",
            f"{COMMON_ATTRIBUTES} abstract",
        )
        facts = facts_of(command, COMMAND_FACTS)
        texts = facts.pop("precondition_texts", [])
        short, long = descriptions(command)
        row: Row = {
            "name": command.get("name"),
            "subsystem": SUBSYSTEM,
            "purpose": long or short or command.get("name"),
        }
        row |= {"idempotent": False, "accept_s": ACCEPT_S, "complete_s": COMPLETE_S}
        row |= self._limits(command) | self._significance(command)
        code = self._code(command, commands)
        row |= ({} if code is None else {"code": code}) | facts
        if "code" not in row:
            raise command.error("has no code", expected="one ArgumentAssignment, or code in AncillaryData gss")
        row["arguments"] = [self._argument(argument) for argument in command.rows("ArgumentList")]
        self._check_order(command, [argument["name"] for argument in row["arguments"]])
        conditions = [self._precondition(c) for c in command.rows("TransmissionConstraintList")]
        if conditions:
            if len(texts) != len(conditions):
                texts = [f"{c['field']} {c['op']} {c['value']}" for c in conditions]
            row["preconditions"] = [c | {"text": text} for c, text in zip(conditions, texts, strict=True)]
        returns = self._containers.returns.get(row["name"])
        return row | ({"returns": returns} if returns else {})

    def _code(self, command: Element, commands: dict[str, Element]) -> int | None:
        base = command.child("BaseMetaCommand")
        if base is None:
            return None
        base.checked("ArgumentAssignmentList", "metaCommandRef")
        parent = commands.get(base.get("metaCommandRef"))
        if parent is None or parent.attributes.get("abstract") not in ("true", "1"):
            raise base.error(
                "the base is not an abstract command of this document", got=base.get("metaCommandRef")[:80]
            )
        assigned = list(base.rows("ArgumentAssignmentList"))
        chosen = [a for a in assigned if a.get("argumentName") == "CODE"] or assigned
        if len(chosen) != 1:
            return None
        return chosen[0].integer(chosen[0].get("argumentValue"))

    def _argument(self, argument: Element) -> Row:
        argument.checked(COMMON_CHILDREN, f"{COMMON_ATTRIBUTES} argumentTypeRef initialValue")
        row, size = self._arguments.row(argument, facts_of(argument, ARGUMENT_FACTS))
        if size is not None:
            raise argument.error("an argument of variable size is not supported")
        short, long = descriptions(argument)
        row |= {"name": argument.get("name")} | ({"purpose": long or short} if long or short else {})
        text = argument.attributes.get("initialValue")
        if text is not None:
            row["default"] = self._default(argument, row["type"], text)
        return row

    def _default(self, argument: Element, kind: str, text: str) -> Any:
        if kind == "bool":
            if text.lower() not in ("true", "false"):
                raise argument.error("initialValue is not a boolean", got=text[:40])
            return text.lower() == "true"
        return text if kind == "enum" or kind.startswith(("str", "bytes")) else argument.number(text)

    def _check_order(self, command: Element, arguments: list[str]) -> None:
        """Raise BadInput unless the container has the arguments in their order, followed by no entry except the
        checksum."""
        container = command.child("CommandContainer")
        if container is None:
            return
        container.checked(f"{COMMON_CHILDREN} EntryList BaseContainer", COMMON_ATTRIBUTES)
        names = []
        for entry in container.need("EntryList").children:
            if entry.tag == "ParameterRefEntry" and self._containers.is_checksum(entry.get("parameterRef")):
                continue
            if entry.tag != "ArgumentRefEntry":
                raise entry.error("is not supported in the container of a command", expected="ArgumentRefEntry")
            names.append(entry.checked("", "argumentRef").get("argumentRef"))
        if names != arguments:
            raise container.error(
                "does not have the arguments of ArgumentList in the same order", got=", ".join(names)[:200]
            )

    def _significance(self, command: Element) -> Row:
        element = command.child("DefaultSignificance")
        if element is None:
            return {}
        element.checked("", "consequenceLevel reasonForWarning")
        level = element.attributes.get("consequenceLevel", "normal")
        if level not in HAZARDS:
            raise element.error("this level is not supported", expected=", ".join(HAZARDS), got=level[:40])
        reason = element.attributes.get("reasonForWarning", "" if level == "normal" else f"marked {level}")
        return {"hazard": HAZARDS[level]} | ({"hazard_reason": reason} if reason else {})

    def _limits(self, command: Element) -> Row:
        limits: Row = {}
        for verifier in command.rows("VerifierSet"):
            key = {"AcceptedVerifier": "accept_s", "CompleteVerifier": "complete_s"}.get(verifier.tag)
            if key is None or key in limits:
                raise verifier.error("is not supported", expected="one AcceptedVerifier and one CompleteVerifier")
            window = verifier.checked("ComparisonList CheckWindow", COMMON_ATTRIBUTES).need("CheckWindow")
            window.checked("", "timeToStopChecking timeWindowIsRelativeTo")
            text = window.get("timeToStopChecking")
            try:
                seconds = Decimal(text.removeprefix("PT").removesuffix("S"))
            except InvalidOperation:
                seconds = Decimal(-1)
            if seconds.is_nan() or not (text.startswith("PT") and text.endswith("S") and 0 <= seconds < 1_000_000):
                raise window.error("timeToStopChecking is not in seconds", expected="PT2.5S", got=text[:40])
            limits[key] = float(seconds)
        return limits

    def _precondition(self, constraint: Element) -> Row:
        comparison = constraint.checked("Comparison").need("Comparison")
        comparison.checked("", "parameterRef comparisonOperator value useCalibratedValue")
        operator = comparison.attributes.get("comparisonOperator", "==")
        op = next((name for name, sign in OPERATORS.items() if sign == operator), None)
        field = self._containers.housekeeping(comparison.get("parameterRef"))
        if op is None or field is None:
            raise comparison.error("is not a comparison of a value of the packet housekeeping")
        text = comparison.get("value")
        kind = field["type"]
        value: Any = text if kind == "enum" or kind.startswith("str") else None
        if value is None:
            value = text.lower() == "true" if kind == "bool" else comparison.number(text)
        return {"field": field["name"], "op": op, "value": value}


def dictionary_of(name: str, data: bytes, byte_order: str | None) -> Dictionary:
    """Return the dictionary in a package's document. Raises BadInput if the byte order of the numbers differs from
    ``byte_order``. None: the driver defines the byte order, so it is not compared."""
    read = read_xtce(name, data)
    if None not in (byte_order, read.byte_order) and byte_order != read.byte_order:
        raise BadInput(
            f"{name} and link.yaml have different byte orders", expected=str(byte_order), got=str(read.byte_order)
        )
    return read.dictionary
