"""Export the telemetry part of the dictionary as XTCE 1.2 (CCSDS 660.0-B-2), for third-party tools.

Containers from the top: ``CCSDSPacket`` (primary header), ``GSSPacket`` (secondary header), both abstract; below them
one container per telemetry packet and event, per transfer message, and per kind of report. Parameter names are
``packet_field``.

Limitations: XTCE has no counted list of rows inside a packet that space-packet-parser can follow, so a list is exported
as its count and the bytes of its rows, and the container ``packet_list_row`` decodes one row; with ``repeat_lists`` the
rows are repeated as the standard defines, for tools that support it. A fixed-size text ends at its first zero byte:
text that fills its field is valid in this protocol, but not for parsers that require the zero.
"""

from __future__ import annotations

from collections.abc import Sequence
from xml.etree import ElementTree as ET

from gss.device.protocol.codec import MAX_LIST, STRUCT, fixed_bytes
from gss.device.protocol.packet import APID_BASE, CRC_BYTES, SECONDARY, PacketType
from gss.instruments.dictionary.definitions import INTEGER_RANGES, Dictionary, Group, Item, Layout, TelemetryField

NAMESPACE = "http://www.omg.org/spec/XTCE/20180204"
SCHEMA = "http://www.omg.org/spec/XTCE/20180204/SpaceSystem.xsd"
INSTANCE = "http://www.w3.org/2001/XMLSchema-instance"
ROOT, GSS = "CCSDSPacket", "GSSPacket"
COMPLETED = "completed"
LONGEST_TEXT = 255
PRIMARY_BITS = (
    ("VERSION", 3, "CCSDS version, 0"),
    ("TYPE", 1, "0 from the device"),
    ("SEC_HDR_FLG", 1, "1: our secondary header follows"),
    ("PKT_APID", 11, "0x100 + packet type"),
    ("SEQ_FLGS", 2, "3: unsegmented"),
    ("SRC_SEQ_CTR", 14, "Sequence count of this APID"),
    ("PKT_LEN", 16, "Bytes that follow, minus 1"),
)
SECONDARY_BITS = (
    ("PACKET_TYPE", 8, "Packet type"),
    ("CODE", 8, "Code of the telemetry packet, event, message, or of the command that a report is about"),
    ("DICTIONARY", 16, "First two bytes of the dictionary's hash"),
    ("REQUEST_ID", 32, "0: sent unasked"),
    ("DEVICE_TIME_S", 32, "Whole seconds since the device's epoch"),
    ("DEVICE_TIME_MS", 16, "Milliseconds of the device's time"),
)
Criteria = Sequence[tuple[str, str, int]]
"""(parameter, operator, raw value); all must hold. Numbers, because some readers compare no labels of enumerations."""


def xtce(dictionary: Dictionary, *, repeat_lists: bool = False) -> str:
    """Return the document as XML text. ``repeat_lists``: export list rows as repeated containers instead of bytes."""
    return _Document(dictionary, repeat_lists).text()


class _Document:
    """XML tree under construction, with types, parameters and containers kept consistent."""

    def __init__(self, dictionary: Dictionary, repeat_lists: bool) -> None:
        self._dictionary, self._repeat = dictionary, repeat_lists
        name = dictionary.device_model
        attributes = {"name": name, "xmlns": NAMESPACE, "xmlns:xsi": INSTANCE}
        attributes["xsi:schemaLocation"] = f"{NAMESPACE} {SCHEMA}"
        self._root = ET.Element("SpaceSystem", attributes)
        text = f"Dictionary version {dictionary.version}, SHA-256 {dictionary.hash_hex}"
        ET.SubElement(self._root, "LongDescription").text = text
        ET.SubElement(self._root, "Header", version=str(dictionary.version), validationStatus="Working")
        telemetry = ET.SubElement(self._root, "TelemetryMetaData")
        self._types = ET.SubElement(telemetry, "ParameterTypeSet")
        self._parameters = ET.SubElement(telemetry, "ParameterSet")
        self._containers = ET.SubElement(telemetry, "ContainerSet")

    def text(self) -> str:
        self._headers()
        for packet in self._dictionary.telemetry:
            self._leaf(packet.name, packet.purpose, PacketType.TELEMETRY, packet.code, packet.fields)
        event = self._dictionary.service("EVENT")
        self._abstract("EVENT", event.purpose, PacketType.EVENT, event.fields)
        for definition in self._dictionary.events:
            name = f"EVENT_{definition.name}"
            self._container(name, definition.purpose, "EVENT", [("CODE", "==", definition.code)], [], crc=True)
        self._reports()
        for service in self._dictionary.services:
            if service.packet == "transfer":
                self._leaf(service.name, service.purpose, PacketType.TRANSFER, service.code, service.fields)
        ET.indent(self._root, " ")
        return '<?xml version="1.0" encoding="UTF-8"?>\n' + ET.tostring(self._root, encoding="unicode") + "\n"

    # --- containers ---------------------------------------------------------------------------------------------

    def _headers(self) -> None:
        for name, bits, purpose in (*PRIMARY_BITS, *SECONDARY_BITS, ("CRC32", 8 * CRC_BYTES, "zlib's CRC-32")):
            self._unsigned(name, bits, purpose)
        self._container(ROOT, "Primary header", "", [], [n for n, _, _ in PRIMARY_BITS], abstract=True)
        ours = [("TYPE", "==", 0), ("SEC_HDR_FLG", "==", 1), ("PKT_APID", ">", APID_BASE)]
        names = [n for n, _, _ in SECONDARY_BITS]
        self._container(GSS, "Secondary header", ROOT, ours, names, abstract=True)

    def _leaf(self, name: str, purpose: str, kind: PacketType, code: int, fields: Layout) -> None:
        where = [*_of_kind(kind), ("CODE", "==", code)]
        self._container(name, purpose, GSS, where, self._entries(name, fields), crc=True)

    def _abstract(self, name: str, purpose: str, kind: PacketType, fields: Layout) -> None:
        self._container(name, purpose, GSS, _of_kind(kind), self._entries(name, fields), abstract=True)

    def _reports(self) -> None:
        """Add the report containers: a completed report ends with the returned values, others after the common fields."""
        report = self._dictionary.service("REPORT")
        self._abstract("REPORT", report.purpose, PacketType.REPORT, report.fields)
        stage, on_the_way = "REPORT_stage", "A stage that is not completion"
        item = next(field for field in report.fields if isinstance(field, Item) and field.name == "stage")
        completed = next(choice.value for choice in item.choices if choice.name == COMPLETED)
        self._container("REPORT_of_stage", on_the_way, "REPORT", [(stage, "!=", completed)], [], crc=True)
        for command in self._dictionary.commands:
            where = [("CODE", "==", command.code), (stage, "==", completed)]
            entries = self._entries(command.name, command.returns)
            self._container(f"REPORT_{command.name}", f"{command.name} is done", "REPORT", where, entries, crc=True)

    def _container(
        self,
        name: str,
        purpose: str,
        base: str,
        criteria: Criteria,
        entries: Sequence[str | ET.Element],
        *,
        abstract: bool = False,
        crc: bool = False,
    ) -> None:
        attributes = {"name": name, "shortDescription": purpose} | ({"abstract": "true"} if abstract else {})
        made = ET.SubElement(self._containers, "SequenceContainer", attributes)
        listed = ET.SubElement(made, "EntryList")
        for entry in (*entries, *(["CRC32"] if crc else [])):
            if isinstance(entry, str):
                ET.SubElement(listed, "ParameterRefEntry", parameterRef=entry)
            else:
                listed.append(entry)
        if base:
            on = ET.SubElement(made, "BaseContainer", containerRef=base)
            comparisons = ET.SubElement(ET.SubElement(on, "RestrictionCriteria"), "ComparisonList")
            for parameter, operator, value in criteria:
                facts = {"parameterRef": parameter, "comparisonOperator": operator, "value": str(value)}
                ET.SubElement(comparisons, "Comparison", facts | {"useCalibratedValue": "false"})

    # --- entries ------------------------------------------------------------------------------------------------

    def _entries(self, owner: str, layout: Layout | Sequence[Item]) -> list[str | ET.Element]:
        """Create the parameters of a layout and return their names in order."""
        entries: list[str | ET.Element] = []
        fixed = SECONDARY.size + CRC_BYTES
        for entry in layout:
            name = f"{owner}_{entry.name}"
            if isinstance(entry, Group):
                entries += self._list(name, entry)
                continue
            if entry.type == "text":
                self._unsigned(f"{name}_length", 8, f"Bytes of {name}")
                entries.append(f"{name}_length")
            self._item(name, entry, fixed)
            entries.append(name)
            fixed += fixed_bytes([entry])
        return entries

    def _list(self, name: str, group: Group) -> list[str | ET.Element]:
        count = f"{name}_count"
        self._unsigned(count, 8, f"Rows of {name}")
        row = f"{name}_row"
        self._container(row, f"One row of {name}", "", [], self._entries(row, group.items))
        if self._repeat:
            entry = ET.Element("ContainerRefEntry", containerRef=row)
            repeat = ET.SubElement(ET.SubElement(entry, "RepeatEntry"), "Count")
            ET.SubElement(ET.SubElement(repeat, "DynamicValue"), "ParameterInstanceRef", parameterRef=count)
            return [count, entry]
        encoding = ET.SubElement(self._type("Binary", name), "BinaryDataEncoding")
        _dynamic(ET.SubElement(encoding, "SizeInBits"), count, 8 * fixed_bytes(group.items), 0)
        self._parameter(name, f"Up to {MAX_LIST} rows, each as {row}")
        return [count, name]

    def _item(self, name: str, item: Item, around: int) -> None:
        """Add type and parameter of one value.

        ``around``: size in bytes of the packet after the primary header, without this value.
        """
        kind = item.type
        if kind in INTEGER_RANGES or kind in ("bool", "enum", "f32", "f64"):
            self._number(name, item)
        elif kind in ("bytes", "rest"):
            encoding = ET.SubElement(self._type("Binary", name), "BinaryDataEncoding")
            size = ET.SubElement(encoding, "SizeInBits")
            if kind == "rest":
                _dynamic(size, "PKT_LEN", 8, 8 - 8 * around)
            else:
                ET.SubElement(size, "FixedValue").text = str(8 * item.size)
        else:
            encoding = ET.SubElement(self._type("String", name), "StringDataEncoding", encoding="UTF-8")
            if kind == "text":
                variable = ET.SubElement(encoding, "Variable", maxSizeInBits=str(8 * LONGEST_TEXT))
                _dynamic(variable, f"{name}_length", 8, 0)
            else:
                size = ET.SubElement(encoding, "SizeInBits")
                ET.SubElement(ET.SubElement(size, "Fixed"), "FixedValue").text = str(8 * item.size)
                ET.SubElement(size, "TerminationChar").text = "00"
        self._parameter(name, item.purpose or getattr(item, "title", ""))

    # --- types --------------------------------------------------------------------------------------------------

    def _type(self, kind: str, name: str, unit: str = "") -> ET.Element:
        made = ET.SubElement(self._types, f"{kind}ParameterType", name=name)
        units = ET.SubElement(made, "UnitSet")
        if unit:
            ET.SubElement(units, "Unit").text = unit
        return made

    def _parameter(self, name: str, purpose: str) -> None:
        facts = {"name": name, "parameterTypeRef": name}
        ET.SubElement(self._parameters, "Parameter", facts | ({"shortDescription": purpose} if purpose else {}))

    def _unsigned(self, name: str, bits: int, purpose: str) -> None:
        made = self._type("Integer", name)
        made.set("signed", "false")
        ET.SubElement(made, "IntegerDataEncoding", sizeInBits=str(bits), encoding="unsigned")
        self._parameter(name, purpose)

    def _number(self, name: str, item: Item) -> None:
        bits = str(8 * STRUCT[item.type].size)
        coefficients = item.conversion.coefficients if isinstance(item, TelemetryField) else ()
        if item.type in ("f32", "f64"):
            made = self._type("Float", name, item.unit)
            made.set("sizeInBits", bits)
            encoding = ET.SubElement(made, "FloatDataEncoding", sizeInBits=bits, encoding="IEEE754_1985")
        else:
            kind = {"bool": "Boolean", "enum": "Enumerated"}.get(item.type, "Float" if coefficients else "Integer")
            made = self._type(kind, name, item.unit)
            signed = item.type.startswith("i")
            if kind == "Integer":
                made.set("signed", str(signed).lower())
            elif kind == "Float":
                made.set("sizeInBits", "64")
            how = "twosComplement" if signed else "unsigned"
            encoding = ET.SubElement(made, "IntegerDataEncoding", sizeInBits=bits, encoding=how)
        if coefficients:
            polynomial = ET.SubElement(ET.SubElement(encoding, "DefaultCalibrator"), "PolynomialCalibrator")
            for power, c in enumerate(coefficients):
                ET.SubElement(polynomial, "Term", coefficient=repr(float(c)), exponent=str(power))
        if item.type == "enum":
            listed = ET.SubElement(made, "EnumerationList")
            for choice in item.choices:
                ET.SubElement(listed, "Enumeration", value=str(choice.value), label=choice.name)


def _of_kind(kind: PacketType) -> list[tuple[str, str, int]]:
    """Return the criteria of a packet type: the APID alone would do, and some readers select packets by it."""
    return [("PKT_APID", "==", APID_BASE + int(kind)), ("PACKET_TYPE", "==", int(kind))]


def _dynamic(size: ET.Element, parameter: str, slope: int, intercept: int) -> None:
    """Add a size in bits: slope · parameter + intercept."""
    dynamic = ET.SubElement(size, "DynamicValue")
    ET.SubElement(dynamic, "ParameterInstanceRef", parameterRef=parameter)
    ET.SubElement(dynamic, "LinearAdjustment", slope=str(slope), intercept=str(intercept))
