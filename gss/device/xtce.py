"""Export a dictionary as XTCE 1.2 (CCSDS 660.0-B-2), for third-party tools; ``read_xtce`` reads it back.

Telemetry containers, from base to derived: ``CCSDSPacket`` (primary header) and ``GSSPacket`` (secondary header), both
abstract; then one container per telemetry packet, event, transfer message and type of report. Parameter names are
``packet_field``. Commands extend the abstract ``GSSCommand``, whose container is the header.

The headers are those of the driver ``gss``. For a sensor with another driver, the containers describe only the content
of the packets, because ``link.yaml`` or the driver defines the header.

Limitations: XTCE has no counted list of rows inside a packet that space-packet-parser can follow, so a list is exported
as its count and the bytes of its rows, and the container ``packet_list_row`` decodes one row. With ``repeat_lists`` the
rows are repeated as the standard defines, for tools that support this. A fixed-size text ends at its first zero byte.
Text that fills its field has no zero byte. It is valid in this protocol, but some parsers require the zero byte. An
argument of the type text or rest is rejected, because XTCE cannot express its size.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any
from xml.etree import ElementTree as ET

from gss.device.protocol.codec import MAX_LIST, fixed_bytes
from gss.device.protocol.packet import APID_BASE, CRC_BYTES, SECONDARY, PacketType
from gss.device.xtce_commands import CommandWriter
from gss.device.xtce_types import TypeWriter, add_facts, checked_name, dynamic, limit_rows, named
from gss.domain.errors import BadInput
from gss.instruments.dictionary import xtce_terms as terms
from gss.instruments.dictionary.definitions import (
    Dictionary,
    EventDefinition,
    Group,
    Item,
    Layout,
    PacketDefinition,
    Service,
    TelemetryField,
)
from gss.instruments.dictionary.read_xtce import read_xtce
from gss.instruments.dictionary.xtce_terms import NAMESPACE
from gss.instruments.package import Instrument

SCHEMA = "http://www.omg.org/spec/XTCE/20180204/SpaceSystem.xsd"
INSTANCE = "http://www.w3.org/2001/XMLSchema-instance"
ROOT, GSS = "CCSDSPacket", "GSSPacket"
COMPLETED, DRIVER = "completed", "gss"
PRIMARY_BITS = (
    ("VERSION", 3, "CCSDS version, 0"),
    ("TYPE", 1, "0 from the device"),
    ("SEC_HDR_FLG", 1, "1: secondary header of GSS follows"),
    ("PKT_APID", 11, "0x100 + packet type"),
    ("SEQ_FLGS", 2, "3: unsegmented"),
    ("SRC_SEQ_CTR", 14, "Sequence count of this APID"),
    ("PKT_LEN", 16, "Bytes that follow, minus 1"),
)
SECONDARY_BITS = (
    ("PACKET_TYPE", 8, "Packet type"),
    ("CODE", 8, "Code of the telemetry packet, event, message, or of the command that a report is about"),
    ("DICTIONARY", 16, "First two bytes of the dictionary's hash"),
    ("REQUEST_ID", 32, "0: sent without a request"),
    ("DEVICE_TIME_S", 32, "Whole seconds since the device's epoch"),
    ("DEVICE_TIME_MS", 16, "Milliseconds of the device's time"),
)
Criteria = Sequence[tuple[str, str, int]]
"""(parameter, operator, raw value); all comparisons must hold. Raw numbers are used because some readers cannot compare
enumeration labels."""


def xtce_of(instrument: Instrument, *, repeat_lists: bool = False) -> str:
    """Return the XTCE document of an instrument's dictionary, with the headers and the byte order of its line."""
    little_endian = instrument.link.content_byte_order == "little"
    headers = instrument.about.driver == DRIVER
    return xtce(instrument.dictionary, headers=headers, little_endian=little_endian, repeat_lists=repeat_lists)


def xtce(
    dictionary: Dictionary, *, headers: bool = True, little_endian: bool = False, repeat_lists: bool = False
) -> str:
    """Return the document as XML text, after verifying that it reads back to an equal dictionary.

    ``headers``: the packets have the headers of the driver ``gss``. ``repeat_lists``: export list rows as repeated
    containers instead of bytes. Raises BadInput for a dictionary that XTCE cannot express.
    """
    draft = _XtceWriter(dictionary, headers, little_endian, repeat_lists, {}).text()
    facts: dict[str, object] = {"layout": layout_of_document(draft).hex(), "hash": dictionary.hash_hex}
    if dictionary.same_layout_as:
        facts["same_layout_as"] = sorted(h.hex() for h in dictionary.same_layout_as)
    text = _XtceWriter(dictionary, headers, little_endian, repeat_lists, facts).text()
    if read_xtce("the document", text.encode()).dictionary != dictionary:
        raise BadInput("the dictionary cannot be written as XTCE without a loss", got=dictionary.device_model)
    return text


def layout_of_document(text: str) -> bytes:
    """Return the hash of the rows in a document. If the document states another hash, it was edited."""
    return read_xtce("the document", text.encode()).dictionary.hash


class _XtceWriter:
    """Builds the XML tree and keeps types, parameters and containers consistent."""

    def __init__(
        self, dictionary: Dictionary, headers: bool, little_endian: bool, repeat_lists: bool, facts: Mapping[str, Any]
    ) -> None:
        self._dictionary, self._headers, self._repeat = dictionary, headers, repeat_lists
        attributes = {"xmlns": NAMESPACE, "xmlns:xsi": INSTANCE, "xsi:schemaLocation": f"{NAMESPACE} {SCHEMA}"}
        self._root = ET.Element("SpaceSystem", attributes | {"name": checked_name(dictionary.device_model)})
        text = f"Dictionary version {dictionary.version}, SHA-256 {dictionary.hash_hex}"
        ET.SubElement(self._root, "LongDescription").text = text
        sets = [{"name": s.name} | ({"note": s.note} if s.note else {}) for s in dictionary.limit_sets]
        add_facts(self._root, {**facts, **({"limit_sets": sets} if sets else {})})
        ET.SubElement(self._root, "Header", version=str(dictionary.version), validationStatus="Working")
        telemetry = ET.SubElement(self._root, "TelemetryMetaData")
        self._types = TypeWriter(ET.SubElement(telemetry, "ParameterTypeSet"), "Parameter", little_endian)
        self._parameters = ET.SubElement(telemetry, "ParameterSet")
        self._containers = ET.SubElement(telemetry, "ContainerSet")
        self._commands = CommandWriter(self._root, dictionary, headers, little_endian)

    def text(self) -> str:
        """Return the document as XML text."""
        if self._headers:
            self._add_headers()
        for packet in self._dictionary.telemetry:
            self._telemetry(packet)
        for service in self._dictionary.services:
            self._service(service)
        if not self._headers:
            self._returns([])
            for event in self._dictionary.events:
                self._event(event, "")
            if self._root.find(".//*[@parameterRef='PKT_LEN']") is not None:  # the size of a value of the type rest
                self._types.unsigned(self._parameters, "PKT_LEN", 16, "Bytes of the content, minus 1", {})
                facts = {terms.ROLE: terms.HEADER}
                self._container("Header", "Size of the content", "", [], ["PKT_LEN"], facts, abstract=True)
        self._commands.write()
        for part in self._root.findall("TelemetryMetaData"):
            for empty in [child for child in part if len(child) == 0]:
                part.remove(empty)
        ET.indent(self._root, " ")
        return '<?xml version="1.0" encoding="UTF-8"?>\n' + ET.tostring(self._root, encoding="unicode") + "\n"

    # --- containers ---------------------------------------------------------------------------------------------------

    def _add_headers(self) -> None:
        for name, bits, purpose in (*PRIMARY_BITS, *SECONDARY_BITS):
            self._types.unsigned(self._parameters, name, bits, purpose, {})
        checksum = {terms.ROLE: terms.CHECKSUM}
        self._types.unsigned(self._parameters, "CRC32", 8 * CRC_BYTES, "zlib's CRC-32", checksum)
        header = {terms.ROLE: terms.HEADER}
        names = [name for name, _, _ in PRIMARY_BITS]
        self._container(ROOT, "Primary header", "", [], names, header, abstract=True)
        ours = [("TYPE", "==", 0), ("SEC_HDR_FLG", "==", 1), ("PKT_APID", ">", APID_BASE)]
        names = [name for name, _, _ in SECONDARY_BITS]
        self._container(GSS, "Secondary header", ROOT, ours, names, header, abstract=True)

    def _telemetry(self, packet: PacketDefinition) -> None:
        facts: dict[str, object] = {terms.ROLE: terms.TELEMETRY, "stale_after_s": packet.stale_after_s}
        if packet.simulator_only:
            facts["simulator_only"] = True
        self._leaf(packet.name, packet.purpose, PacketType.TELEMETRY, packet.code, packet.fields, facts)

    def _service(self, service: Service) -> None:
        facts = {terms.ROLE: terms.SERVICE, "packet": service.packet, "code": service.code}
        if service.packet == "transfer" or not self._headers:
            self._leaf(service.name, service.purpose, PacketType.TRANSFER, service.code, service.fields, facts)
            return
        kind = PacketType.EVENT if service.packet == "event" else PacketType.REPORT
        entries = self._entries(service.name, service.fields)
        self._container(service.name, service.purpose, GSS, _of_kind(kind), entries, facts, abstract=True)
        if kind is PacketType.EVENT:
            for event in self._dictionary.events:
                self._event(event, service.name)
        else:
            self._reports(service)

    def _event(self, event: EventDefinition, base: str) -> None:
        facts: dict[str, object] = {terms.ROLE: terms.EVENT, "severity": event.severity}
        if event.action:
            facts["action"] = event.action
        facts |= {} if base else {"code": event.code}
        where = [("CODE", "==", event.code)]
        self._container(f"EVENT_{event.name}", event.purpose, base, where, [], facts, crc=bool(base))

    def _leaf(
        self, name: str, purpose: str, kind: PacketType, code: int, fields: Layout, facts: Mapping[str, Any]
    ) -> None:
        entries = self._entries(name, fields, facts.get("stale_after_s", 0.0))
        if self._headers:
            where = [*_of_kind(kind), ("CODE", "==", code)]
            self._container(name, purpose, GSS, where, entries, facts, crc=True)
        else:
            self._container(name, purpose, "", [], entries, {**facts, "code": code})

    def _reports(self, report: Service) -> None:
        """Add the report containers: a completed report ends with the returned values, all other reports end after the
        common fields."""
        stage, on_the_way = f"{report.name}_stage", "A stage that is not completion"
        item = next(field for field in report.fields if isinstance(field, Item) and field.name == "stage")
        completed = next(choice.value for choice in item.choices if choice.name == COMPLETED)
        facts = {terms.ROLE: terms.STAGE}
        where = [(stage, "!=", completed)]
        self._container(f"{report.name}_of_stage", on_the_way, report.name, where, [], facts, crc=True)
        self._returns([(stage, "==", completed)], report.name)

    def _returns(self, completed: Criteria, base: str = "") -> None:
        for command in self._dictionary.commands:
            if not base and not command.returns:
                continue
            where = [("CODE", "==", command.code), *completed]
            facts = {terms.ROLE: terms.RETURNS, "command": command.name}
            entries, name = self._entries(command.name, command.returns), f"REPORT_{command.name}"
            self._container(name, f"{command.name} is done", base, where, entries, facts, crc=bool(base))

    def _container(
        self,
        name: str,
        purpose: str,
        base: str,
        criteria: Criteria,
        entries: Sequence[str | ET.Element],
        facts: Mapping[str, Any],
        *,
        abstract: bool = False,
        crc: bool = False,
    ) -> None:
        attributes = {"shortDescription": purpose} | ({"abstract": "true"} if abstract else {})
        container = named(self._containers, "SequenceContainer", name, attributes)
        add_facts(container, facts)
        listed = ET.SubElement(container, "EntryList")
        for entry in (*entries, *(["CRC32"] if crc else [])):
            if isinstance(entry, str):
                ET.SubElement(listed, "ParameterRefEntry", parameterRef=entry)
            else:
                listed.append(entry)
        if base:
            on = ET.SubElement(container, "BaseContainer", containerRef=base)
            comparisons = ET.SubElement(ET.SubElement(on, "RestrictionCriteria"), "ComparisonList")
            for parameter, operator, value in criteria:
                terms_of = {"parameterRef": parameter, "comparisonOperator": operator, "value": str(value)}
                ET.SubElement(comparisons, "Comparison", terms_of | {"useCalibratedValue": "false"})

    # --- entries ------------------------------------------------------------------------------------------------------

    def _entries(
        self, owner: str, layout: Layout | Sequence[Item], stale_after_s: float = 0.0
    ) -> list[str | ET.Element]:
        """Create the parameters of a layout and return their names in order. ``stale_after_s``: value of the packet."""
        entries: list[str | ET.Element] = []
        fixed = SECONDARY.size + CRC_BYTES if self._headers else 0
        for entry in layout:
            name = f"{owner}_{entry.name}"
            if isinstance(entry, Group):
                entries += self._list(name, entry)
                continue
            if entry.type == "text":
                self._types.unsigned(self._parameters, f"{name}_length", 8, f"Bytes of {name}", {})
                entries.append(f"{name}_length")
            self._value(name, entry, fixed, stale_after_s)
            entries.append(name)
            fixed += fixed_bytes([entry])
        return entries

    def _value(self, name: str, item: Item, around: int, stale_after_s: float) -> None:
        facts = self._types.value(name, item, around)
        if not isinstance(item, TelemetryField):
            self._types.entry(self._parameters, name, name, {"shortDescription": item.purpose}, facts)
            return
        facts |= {key: text for key in ("page", "decimals", "action") if (text := getattr(item, key))}
        if item.stale_after_s != stale_after_s:
            facts["stale_after_s"] = item.stale_after_s
        if item.sets:
            facts["sets"] = {key: limit_rows(limits) for key, limits in item.sets.items()}
        attributes = {"shortDescription": item.title if item.title != item.name else ""}
        self._types.entry(self._parameters, name, name, attributes, facts, item.purpose)

    def _list(self, name: str, group: Group) -> list[str | ET.Element]:
        count = f"{name}_count"
        self._types.unsigned(self._parameters, count, 8 if group.count == "u8" else 16, f"Rows of {name}", {})
        row = f"{name}_row"
        facts: dict[str, object] = {terms.ROLE: terms.ROW, "list": group.name}
        facts |= {"slots": group.slots} if group.slots else {}
        facts |= {"purpose": group.purpose} if group.purpose else {}
        self._container(row, f"One row of {name}", "", [], self._entries(row, group.items), facts)
        if self._repeat:
            entry = ET.Element("ContainerRefEntry", containerRef=row)
            repeat = ET.SubElement(ET.SubElement(entry, "RepeatEntry"), "Count")
            if group.slots:
                ET.SubElement(repeat, "FixedValue").text = str(group.slots)
            else:
                ET.SubElement(ET.SubElement(repeat, "DynamicValue"), "ParameterInstanceRef", parameterRef=count)
            return [count, entry]
        encoding = ET.SubElement(self._types.make("Binary", name), "BinaryDataEncoding")
        size, row_bits = ET.SubElement(encoding, "SizeInBits"), 8 * fixed_bytes(group.items)
        if group.slots:
            ET.SubElement(size, "FixedValue").text = str(group.slots * row_bits)
        else:
            dynamic(size, count, row_bits, 0)
        purpose = f"Up to {group.slots or MAX_LIST} rows, each as {row}"
        self._types.entry(self._parameters, name, name, {"shortDescription": purpose}, {"rows": row})
        return [count, name]


def _of_kind(kind: PacketType) -> list[tuple[str, str, int]]:
    """Return the criteria of a packet type. The APID alone is sufficient; some readers select packets by it."""
    return [("PKT_APID", "==", APID_BASE + int(kind)), ("PACKET_TYPE", "==", int(kind))]
