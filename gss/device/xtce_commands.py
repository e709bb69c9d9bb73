"""Commands of an XTCE document: arguments with ranges, containers, significance, conditions and time limits."""

from __future__ import annotations

from decimal import Decimal
from xml.etree import ElementTree as ET

from gss.device.protocol.packet import APID_BASE, SECONDARY_FLAG, TO_DEVICE, PacketType
from gss.device.xtce_types import TypeWriter, add_facts, initial_value, named
from gss.domain.errors import BadInput
from gss.instruments.dictionary import xtce_terms as terms
from gss.instruments.dictionary.definitions import Argument, CommandDefinition, Dictionary, Hazard, Item, Precondition

BASE = "GSSCommand"
STAGES = (("AcceptedVerifier", "accepted", "accept_s"), ("CompleteVerifier", "completed", "complete_s"))


class CommandWriter:
    """Writes ``CommandMetaData``. ``headers``: if True, commands have the header of the driver ``gss``, whose reports
    verify them."""

    def __init__(self, root: ET.Element, dictionary: Dictionary, headers: bool, little_endian: bool) -> None:
        self._dictionary, self._headers = dictionary, headers
        part = ET.SubElement(root, "CommandMetaData") if dictionary.commands else ET.Element("CommandMetaData")
        self._argument_types = ET.SubElement(part, "ArgumentTypeSet")
        self._types = TypeWriter(self._argument_types, "Argument", little_endian)
        self._part, self._commands = part, ET.SubElement(part, "MetaCommandSet")

    def write(self) -> None:
        """Add all commands."""
        if self._headers:
            self._base()
        for command in self._dictionary.commands:
            self._command(command)
        if len(self._argument_types) == 0:
            self._part.remove(self._argument_types)

    def _base(self) -> None:
        base = named(
            self._commands, "MetaCommand", BASE, {"abstract": "true", "shortDescription": "Header of commands"}
        )
        arguments = ET.SubElement(base, "ArgumentList")
        self._types.unsigned(arguments, "CODE", 8, "Code of the command", {})
        entries = ET.SubElement(named(base, "CommandContainer", BASE), "EntryList")
        kind = PacketType.COMMAND
        _fixed(entries, "Version_type_flag_APID", (TO_DEVICE | SECONDARY_FLAG | APID_BASE + kind).to_bytes(2, "big"))
        for name in ("SEQ_FLGS", "SRC_SEQ_CTR", "PKT_LEN"):
            ET.SubElement(entries, "ParameterRefEntry", parameterRef=name)
        _fixed(entries, "PACKET_TYPE", bytes([kind]))
        ET.SubElement(entries, "ArgumentRefEntry", argumentRef="CODE")
        _fixed(entries, "DICTIONARY", self._dictionary.hash[:2])
        ET.SubElement(entries, "ParameterRefEntry", parameterRef="REQUEST_ID")
        _fixed(entries, "DEVICE_TIME", bytes(6))

    def _command(self, command: CommandDefinition) -> None:
        element = named(self._commands, "MetaCommand", command.name)
        ET.SubElement(element, "LongDescription").text = command.purpose
        add_facts(element, self._facts(command))
        if self._headers:
            base = ET.SubElement(element, "BaseMetaCommand", metaCommandRef=BASE)
            assigned = ET.SubElement(base, "ArgumentAssignmentList")
            ET.SubElement(assigned, "ArgumentAssignment", argumentName="CODE", argumentValue=str(command.code))
        if command.arguments:
            arguments = ET.SubElement(element, "ArgumentList")
            for argument in command.arguments:
                self._argument(arguments, command, argument)
        container = named(element, "CommandContainer", command.name)
        entries = ET.SubElement(container, "EntryList")
        for argument in command.arguments:
            ET.SubElement(entries, "ArgumentRefEntry", argumentRef=argument.name)
        if self._headers:
            ET.SubElement(entries, "ParameterRefEntry", parameterRef="CRC32")
            ET.SubElement(container, "BaseContainer", containerRef=BASE)
        if command.preconditions:
            constraints = ET.SubElement(element, "TransmissionConstraintList")
            for condition in command.preconditions:
                _constraint(ET.SubElement(constraints, "TransmissionConstraint"), condition)
        if command.hazard is not Hazard.NONE:
            level = {"consequenceLevel": terms.LEVELS[command.hazard]}
            ET.SubElement(element, "DefaultSignificance", {"reasonForWarning": command.hazard_reason} | level)
        if self._verified:
            self._verifiers(element, command)

    def _argument(self, arguments: ET.Element, command: CommandDefinition, argument: Argument) -> None:
        if argument.type in ("text", "rest"):
            raise BadInput(f"{command.name}.{argument.name}: XTCE has no argument of the type {argument.type}")
        type_name = f"{command.name}_{argument.name}"
        facts = self._types.value(type_name, argument, 0)
        attributes = {} if argument.default is None else {"initialValue": initial_value(argument.default)}
        self._types.entry(arguments, argument.name, type_name, attributes, facts, argument.purpose)

    @property
    def _verified(self) -> bool:
        return self._headers and any(s.name == "REPORT" for s in self._dictionary.services)

    def _facts(self, command: CommandDefinition) -> dict[str, object]:
        """Return the properties for which XTCE has no element, without those equal to the reader's defaults."""
        facts: dict[str, object] = {"subsystem": command.subsystem}
        facts |= {} if self._headers else {"code": command.code}
        facts |= {} if self._verified else {"accept_s": command.accept_s, "complete_s": command.complete_s}
        facts |= {} if command.role == "operator" else {"role": command.role}
        flags = ("favourite", "idempotent", "any_dictionary", "simulator_only")
        facts |= {flag: True for flag in flags if getattr(command, flag)}
        if command.preconditions:
            facts["precondition_texts"] = [condition.text for condition in command.preconditions]
        if command.hazard is Hazard.NONE and command.hazard_reason:
            facts["hazard_reason"] = command.hazard_reason
        return facts

    def _verifiers(self, element: ET.Element, command: CommandDefinition) -> None:
        report = self._dictionary.service("REPORT")
        stage = next(field for field in report.fields if isinstance(field, Item) and field.name == "stage")
        verifiers = ET.SubElement(element, "VerifierSet")
        for tag, name, limit in STAGES:
            verifier = ET.SubElement(verifiers, tag)
            listed = ET.SubElement(verifier, "ComparisonList")
            for parameter, value in (("CODE", command.code), ("REPORT_stage", stage.choice(name).value)):
                facts = {"parameterRef": parameter, "value": str(value), "useCalibratedValue": "false"}
                ET.SubElement(listed, "Comparison", facts)
            seconds = format(Decimal(repr(getattr(command, limit))), "f")
            ET.SubElement(verifier, "CheckWindow", timeToStopChecking=f"PT{seconds}S")


def _constraint(constraint: ET.Element, condition: Precondition) -> None:
    facts = {"parameterRef": f"housekeeping_{condition.field}", "comparisonOperator": terms.OPERATORS[condition.op]}
    ET.SubElement(constraint, "Comparison", facts | {"value": initial_value(condition.value)})


def _fixed(entries: ET.Element, name: str, value: bytes) -> None:
    facts = {"name": name, "binaryValue": value.hex().upper(), "sizeInBits": str(8 * len(value))}
    ET.SubElement(entries, "FixedValueEntry", facts)
