"""Export a dictionary as command and telemetry definitions of OpenC3 COSMOS (``cmd_tlm/*.txt``).

COSMOS identifies a packet by the values of its ID items, so the definitions need the headers of the driver ``gss``. For
each packet they contain primary header, secondary header, content and CRC-32, as one packet leaves the framing of the
line.

Limitations: COSMOS has no list of rows inside a packet, so a list is a block whose size follows from its count. COSMOS
has two levels of limits; ``warning`` is yellow and ``critical`` is red, and the level ``watch`` is omitted. A limit set
of the dictionary is a limits set of the same name. Timeouts, preconditions and roles are omitted. Texts cannot contain
double quotes or line breaks, so these are replaced.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

from gss.device.protocol.codec import STRUCT, fixed_bytes
from gss.device.protocol.packet import APID_BASE, CRC_BYTES, PacketType
from gss.device.xtce import COMPLETED, DRIVER, PRIMARY_BITS, SECONDARY_BITS
from gss.domain.errors import BadInput
from gss.domain.limits import OPEN, Limits, Range
from gss.instruments.dictionary.definitions import (
    FLOATS,
    INTEGER_RANGES,
    Argument,
    CommandDefinition,
    Dictionary,
    Group,
    Hazard,
    Item,
    Layout,
    TelemetryField,
    Value,
)
from gss.instruments.package import Instrument

UNLIMITED = 1.0e38
"""Bound of an absent limit: COSMOS requires all four bounds, and accepts no infinity. The yellow bounds are half of it,
because COSMOS requires that they differ from each other and lie inside the red ones."""
CRC_BITS = 8 * CRC_BYTES
HEADER_ITEMS = tuple((name, bits) for name, bits, _ in (*PRIMARY_BITS, *SECONDARY_BITS))


def cosmos_files(instrument: Instrument, target: str = "") -> dict[str, str]:
    """Return the text of ``cmd.txt`` and ``tlm.txt`` by name. ``target``: name of the target in COSMOS, which is the
    device model by default. Raises BadInput if the driver is not ``gss`` or the name is invalid."""
    if instrument.about.driver != DRIVER:
        raise BadInput(
            f"{instrument.name} cannot be exported for COSMOS, because its driver defines the header of its packets",
            expected=f"an instrument with the driver {DRIVER}",
            got=f"the driver {instrument.about.driver}",
            hint="Export XTCE, which describes the content of the packets.",
        )
    dictionary = instrument.dictionary
    name = (target or dictionary.device_model).upper()
    if not name.replace("_", "").replace("-", "").isalnum():
        raise BadInput("invalid name of a target", expected="letters, digits, _ and -", got=target[:80])
    note = f"# {dictionary.device_model}: dictionary version {dictionary.version}, SHA-256 {dictionary.hash_hex}"
    return {
        "cmd.txt": "\n".join([note, *_commands(dictionary, name)]) + "\n",
        "tlm.txt": "\n".join([note, *_telemetry(dictionary, name)]) + "\n",
    }


# --- commands ---------------------------------------------------------------------------------------------------------


def _commands(dictionary: Dictionary, target: str) -> Iterator[str]:
    for command in dictionary.commands:
        yield ""
        yield f"COMMAND {target} {command.name} BIG_ENDIAN {_quoted(command.purpose)}"
        if command.hazard in (Hazard.WARNING, Hazard.CRITICAL):
            yield f"  HAZARDOUS {_quoted(command.hazard_reason)}"
        fixed = {
            "TYPE": 1,
            "SEC_HDR_FLG": 1,
            "SEQ_FLGS": 3,
            "DICTIONARY": dictionary.prefix,
        }
        ids = {"PKT_APID": APID_BASE + PacketType.COMMAND, "PACKET_TYPE": int(PacketType.COMMAND), "CODE": command.code}
        for name, bits in HEADER_ITEMS:
            keyword = "APPEND_ID_PARAMETER" if name in ids else "APPEND_PARAMETER"
            yield f"  {keyword} {name} {bits} UINT MIN MAX {ids.get(name, fixed.get(name, 0))}"
        for argument in command.arguments:
            yield from _argument(command, argument)
        yield f"  APPEND_PARAMETER CRC32 {CRC_BITS} UINT MIN MAX 0"


def _argument(command: CommandDefinition, argument: Argument) -> Iterator[str]:
    name, purpose = argument.name.upper(), _quoted(argument.purpose)
    if argument.type in ("text", "rest"):
        if argument is not command.arguments[-1]:
            raise BadInput(f"{command.name}.{argument.name}: only the last argument can have a variable size")
        if argument.type == "text":
            yield f"  APPEND_PARAMETER {name}_LENGTH 8 UINT MIN MAX 0"
    kind, bits = _type_of(argument), _bits_of(argument)
    if kind in ("STRING", "BLOCK"):
        default = _quoted("" if argument.default is None else str(argument.default))
        yield f"  APPEND_PARAMETER {name} {bits} {kind} {default} {purpose}"
    else:
        low, high = _bounds_of(argument)
        default = _number(argument, low if argument.default is None else argument.default)
        yield f"  APPEND_PARAMETER {name} {bits} {kind} {low} {high} {default} {purpose}"
    if argument.type == "text":
        yield f"    VARIABLE_BIT_SIZE {name}_LENGTH 8 0"
    if argument.default is None:
        yield "    REQUIRED"
    for choice in argument.choices:
        hazardous = choice.hazard in (Hazard.WARNING, Hazard.CRITICAL)
        mark = f" HAZARDOUS {_quoted(choice.note)}" if hazardous else ""
        yield f"    STATE {choice.name.upper()} {choice.value}{mark}"
    if argument.type == "bool":
        yield from _truth_states()
    elif argument.unit and not argument.choices:
        yield _units(argument)


def _bounds_of(argument: Argument) -> tuple[str, str]:
    """Return the range of a number as COSMOS reads it; MIN and MAX are the range of the type."""
    if argument.choices:
        values = [choice.value for choice in argument.choices]
        return str(min(values)), str(max(values))
    if argument.type == "bool":
        return "0", "1"
    bounds = (argument.minimum, argument.maximum)
    low, high = ("" if b is None else repr(int(b) if argument.type in INTEGER_RANGES else float(b)) for b in bounds)
    return low or "MIN", high or "MAX"


def _number(argument: Argument, value: Value | str) -> str:
    """Return a default value as COSMOS reads it: the number of a choice, 0 or 1, or the number itself."""
    if value == "MIN":
        return "0"
    if argument.choices:
        named = {choice.name: choice.value for choice in argument.choices}
        return str(named.get(str(value), value))
    return str(int(value)) if isinstance(value, bool) else str(value)


# --- telemetry --------------------------------------------------------------------------------------------------------


def _telemetry(dictionary: Dictionary, target: str) -> Iterator[str]:
    for packet in dictionary.telemetry:
        ids = {"PACKET_TYPE": int(PacketType.TELEMETRY), "CODE": packet.code}
        yield from _packet(target, packet.name, packet.purpose, PacketType.TELEMETRY, ids, packet.fields)
    for service in dictionary.services:
        if service.packet == "transfer":
            ids = {"PACKET_TYPE": int(PacketType.TRANSFER), "CODE": service.code}
            yield from _packet(target, service.name, service.purpose, PacketType.TRANSFER, ids, service.fields)
        elif service.packet == "event":
            for event in dictionary.events:
                ids = {"PACKET_TYPE": int(PacketType.EVENT), "CODE": event.code}
                name = f"EVENT_{event.name}"
                yield from _packet(target, name, event.purpose, PacketType.EVENT, ids, service.fields)
        else:
            yield from _reports(dictionary, target, service.fields, service.name, service.purpose)


def _reports(dictionary: Dictionary, target: str, fields: Layout, name: str, purpose: str) -> Iterator[str]:
    """Yield the reports. A completed command returns values; these packets come first, because COSMOS selects the first
    packet whose ID items agree."""
    stage = next(field for field in fields if isinstance(field, Item) and field.name == "stage")
    kind = {"PACKET_TYPE": int(PacketType.REPORT)}
    for command in dictionary.commands:
        if command.returns:
            ids = kind | {"CODE": command.code, stage.name: stage.choice(COMPLETED).value}
            title = f"{command.name} is done"
            layout = (*fields, *command.returns)
            yield from _packet(target, f"{name}_{command.name}", title, PacketType.REPORT, ids, layout)
    yield from _packet(target, name, purpose, PacketType.REPORT, kind, fields)


def _packet(
    target: str, name: str, purpose: str, kind: PacketType, ids: Mapping[str, int], layout: Layout
) -> Iterator[str]:
    yield ""
    yield f"TELEMETRY {target} {name} BIG_ENDIAN {_quoted(purpose)}"
    for header, bits in HEADER_ITEMS:
        if header == "PKT_APID":
            yield f"  APPEND_ID_ITEM {header} {bits} UINT {APID_BASE + kind}"
        elif header in ids:
            yield f"  APPEND_ID_ITEM {header} {bits} UINT {ids[header]}"
        else:
            yield f"  APPEND_ITEM {header} {bits} UINT"
    names = unique_names(layout)
    for field_name, entry in zip(names, layout, strict=True):
        if isinstance(entry, Group):
            yield from _list(field_name, entry)
        else:
            yield from _field(field_name, entry, ids.get(entry.name))
    if any(isinstance(entry, Item) and entry.type == "rest" for entry in layout):
        yield f"  ITEM CRC32 -{CRC_BITS} {CRC_BITS} UINT"
    else:
        yield f"  APPEND_ITEM CRC32 {CRC_BITS} UINT"


def unique_names(layout: Layout) -> list[str]:
    """Return the names of a layout in capitals. A name that a header or an earlier field has gets a suffix."""
    used, names = {name for name, _ in HEADER_ITEMS} | {"CRC32"}, []
    for entry in layout:
        name = entry.name.upper()
        while name in used:
            name += "_2"
        used.add(name)
        names.append(name)
    return names


def _list(name: str, group: Group) -> Iterator[str]:
    row_bits = 8 * fixed_bytes(group.items)
    columns = ", ".join(f"{item.name} {item.type}" for item in group.items)
    yield f"  APPEND_ITEM {name}_COUNT {8 if group.count == 'u8' else 16} UINT"
    yield f"  APPEND_ITEM {name} {group.slots * row_bits} BLOCK {_quoted(f'Rows of {row_bits // 8} B: {columns}')}"
    if not group.slots:
        yield f"    VARIABLE_BIT_SIZE {name}_COUNT {row_bits} 0"


def _field(name: str, item: Item, code: int | None) -> Iterator[str]:
    if item.type == "text":
        yield f"  APPEND_ITEM {name}_LENGTH 8 UINT"
    keyword, identity = ("APPEND_ITEM", "") if code is None else ("APPEND_ID_ITEM", f" {code}")
    yield f"  {keyword} {name} {_bits_of(item)} {_type_of(item)}{identity} {_quoted(item.purpose)}"
    if item.type == "text":
        yield f"    VARIABLE_BIT_SIZE {name}_LENGTH 8 0"
    for choice in item.choices:
        yield f"    STATE {choice.name.upper()} {choice.value}"
    if item.type == "bool":
        yield from _truth_states()
    elif item.unit and not item.choices:
        yield _units(item)
    if isinstance(item, TelemetryField):
        if item.conversion.coefficients:
            yield "    POLY_READ_CONVERSION " + " ".join(repr(float(c)) for c in item.conversion.coefficients)
        if not item.choices and item.type != "bool":
            yield from _limits(item)


def _limits(field: TelemetryField) -> Iterator[str]:
    """Yield the limits of a field. COSMOS requires the set DEFAULT if there is any other set."""
    sets = {"DEFAULT": field.limits, **field.sets}
    if any(_has_colours(limits) for limits in sets.values()):
        for name, limits in sets.items():
            bounds = " ".join(map(repr, _bounds(limits)))
            yield f"    LIMITS {name.upper()} {field.persistence} ENABLED {bounds}"


def _has_colours(limits: Limits) -> bool:
    return limits.warning != OPEN or limits.critical != OPEN


def _bounds(limits: Limits) -> tuple[float, float, float, float]:
    """Return red low, yellow low, yellow high and red high. A level without a bound gets the bound of the other level, or
    a bound that no value exceeds."""

    def side(k: int, red: Range, yellow: Range, free: float) -> tuple[float, float]:
        outer, inner = red[k], yellow[k]
        if inner is None:
            inner = outer if outer is not None else free / 2
        return (free if outer is None else float(outer)), float(inner)

    red_low, yellow_low = side(0, limits.critical, limits.warning, -UNLIMITED)
    red_high, yellow_high = side(1, limits.critical, limits.warning, UNLIMITED)
    return red_low, yellow_low, yellow_high, red_high


# --- words ------------------------------------------------------------------------------------------------------------


def _type_of(item: Item) -> str:
    if item.type in FLOATS:
        return "FLOAT"
    if item.type in ("bytes", "rest"):
        return "BLOCK"
    if item.type in ("str", "text"):
        return "STRING"
    return "INT" if item.type.startswith("i") else "UINT"


def _bits_of(item: Item) -> int:
    """Return the size in bits as COSMOS writes it: 0 for a variable size, negative for "up to the checksum"."""
    if item.type == "text":
        return 0
    if item.type == "rest":
        return 0 if isinstance(item, Argument) else -CRC_BITS
    return 8 * (STRUCT[item.type].size if item.type in STRUCT else item.size)


def _truth_states() -> Sequence[str]:
    return "    STATE FALSE 0", "    STATE TRUE 1"


def _units(item: Item) -> str:
    return f"    UNITS {_quoted(item.unit)} {_quoted(item.unit)}"


def _quoted(text: str) -> str:
    """Return a text in double quotes on one line."""
    return '"' + " ".join(text.split()).replace('"', "'") + '"'
