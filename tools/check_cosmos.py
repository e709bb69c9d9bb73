"""Compare the definitions for OpenC3 COSMOS with this project's encoder, by the Python package ``openc3``.

The package needs other versions of libraries, so the check has two steps in two environments:

``python -m tools.check_cosmos write FOLDER [--instrument NAME]`` writes ``cmd.txt``, ``tlm.txt`` and ``vectors.json``:
packets with random content as this project encodes them, and their values.

``python check_cosmos.py read FOLDER``, in an environment with ``openc3`` only, loads the definitions, identifies each
packet, compares all values, builds each command from its arguments and compares its bytes. The exit status is 0 if all
are equal.
"""

from __future__ import annotations

import argparse
import json
import random
import struct
import sys
from pathlib import Path
from typing import Any

TARGET = "SENSOR"
VECTORS_PER_PACKET = 20
SEED = 2611
READ_PROTOCOL = (32, 16, 7, 1, "BIG_ENDIAN", 0, None, None, True)
"""Arguments of the LengthProtocol: offset, size and meaning of the length field of a CCSDS packet."""


def write(folder: Path, instrument_name: str) -> int:
    """Write the definitions and the vectors."""
    from gss.device.cosmos import cosmos_files
    from gss.device.protocol.packet import PacketType
    from gss.instruments.registry import shipped_registry

    instrument = shipped_registry().get(instrument_name)
    dictionary = instrument.dictionary
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in cosmos_files(instrument, TARGET).items():
        (folder / name).write_text(text)
    chance = random.Random(SEED)
    packets, report = [], dictionary.service("REPORT").fields
    for _ in range(VECTORS_PER_PACKET):
        kind = PacketType.TELEMETRY
        packets += [_packet(dictionary, chance, p.name, kind, p.code, p.fields) for p in dictionary.telemetry]
        for event in dictionary.events:
            fields = dictionary.service("EVENT").fields
            packets.append(_packet(dictionary, chance, f"EVENT_{event.name}", PacketType.EVENT, event.code, fields))
        for service in dictionary.services:
            if service.packet == "transfer":
                kind = PacketType.TRANSFER
                packets.append(_packet(dictionary, chance, service.name, kind, service.code, service.fields))
        for command in dictionary.commands:
            kind, code = PacketType.REPORT, command.code
            packets.append(_packet(dictionary, chance, "REPORT", kind, code, report, stage="accepted"))
            name = f"REPORT_{command.name}" if command.returns else "REPORT"
            layout = (*report, *command.returns)
            packets.append(_packet(dictionary, chance, name, kind, code, layout, stage="completed"))
    commands = [_command(dictionary, chance, c) for c in dictionary.commands for _ in range(VECTORS_PER_PACKET)]
    (folder / "vectors.json").write_text(json.dumps({"packets": packets, "commands": commands}))
    print(f"{folder}: {len(packets)} packets, {len(commands)} commands")
    return 0


def _packet(
    dictionary: Any, chance: random.Random, name: str, kind: Any, code: int, layout: Any, **fixed: str
) -> dict[str, object]:
    from gss.device.cosmos import unique_names
    from gss.device.protocol.codec import decode, encode
    from gss.device.protocol.packet import Packet
    from gss.device.protocol.sender import encode_packet
    from gss.instruments.dictionary.definitions import Group

    values, lists = {}, {}
    for entry in layout:
        if isinstance(entry, Group):
            count = chance.randrange(min(entry.slots or 6, 6) + 1)
            lists[entry.name] = [{item.name: _value(chance, item) for item in entry.items} for _ in range(count)]
        else:
            values[entry.name] = fixed.get(entry.name) or _value(chance, entry)
    payload = encode(layout, values, lists)
    read = decode(layout, payload)
    expected: dict[str, object] = {}
    for item_name, entry in zip(unique_names(layout), layout, strict=True):
        if isinstance(entry, Group):
            expected[f"{item_name}_COUNT"] = len(lists[entry.name])
        else:
            raw = read.raw[entry.name]
            expected[item_name] = raw.hex() if isinstance(raw, bytes) else raw
    data = encode_packet(Packet(kind, code, 7, payload, dictionary.prefix, False, 11, 3661.25))
    return {"name": name, "bytes": data.hex(), "values": expected}


def _command(dictionary: Any, chance: random.Random, command: Any) -> dict[str, object]:
    from gss.device.protocol.codec import encode_command
    from gss.device.protocol.packet import Packet, PacketType
    from gss.device.protocol.sender import encode_packet

    values = {argument.name: _value(chance, argument) for argument in command.arguments}
    payload = encode_command(command, values).payload
    data = encode_packet(Packet(PacketType.COMMAND, command.code, 9, payload, dictionary.prefix, True, 3))
    named = {k.upper(): v.hex() if isinstance(v, bytes) else v for k, v in values.items()}
    return {"name": command.name, "bytes": data.hex(), "values": named}


def _value(chance: random.Random, item: Any) -> Any:
    """Return a random value of an item, within the range of an argument."""
    from gss.instruments.dictionary.definitions import INTEGER_RANGES

    low, high = getattr(item, "minimum", None), getattr(item, "maximum", None)
    if item.type in INTEGER_RANGES:
        least, most = INTEGER_RANGES[item.type]
        return chance.randint(least if low is None else int(low), most if high is None else int(high))
    if item.type in ("f32", "f64"):
        number = chance.uniform(-1e6 if low is None else low, 1e6 if high is None else high)
        return struct.unpack(">f", struct.pack(">f", number))[0] if item.type == "f32" else number
    if item.type == "enum":
        return chance.choice([choice.name for choice in item.choices])
    if item.type == "bool":
        return chance.random() < 0.5
    size = item.size or chance.randrange(1, 30)
    if item.type in ("bytes", "rest"):
        return chance.randbytes(size)
    return "".join(chance.choice("abcdefgh XYZ-09") for _ in range(max(size - 1, 1))).strip() or "x"


def read(folder: Path) -> int:
    """Load the definitions with ``openc3`` and compare. Returns the exit status."""
    from openc3.interfaces.protocols.crc_protocol import CrcProtocol
    from openc3.interfaces.protocols.length_protocol import LengthProtocol
    from openc3.packets.packet_config import PacketConfig
    from openc3.packets.telemetry import Telemetry

    config = PacketConfig()
    for name in ("cmd.txt", "tlm.txt"):
        config.process_file(str(folder / name), TARGET)
    vectors = json.loads((folder / "vectors.json").read_text())
    telemetry, problems, compared = Telemetry(config, None), list(config.warnings), 0
    for vector in vectors["packets"]:
        packet = telemetry.identify_and_set_buffer(bytes.fromhex(vector["bytes"]), [TARGET])
        if packet is None or packet.packet_name != vector["name"].upper():
            problems.append(f"{vector['name']} identified as {packet.packet_name if packet else 'nothing'}")
            continue
        for name, value in vector["values"].items():
            got, compared = packet.read(name, "RAW"), compared + 1
            if not _equal(got, value):
                problems.append(f"{vector['name']}.{name}: {value!r}, COSMOS reads {got!r}")
    length, checksum = LengthProtocol(*READ_PROTOCOL), CrcProtocol("CRC32")
    for vector in vectors["commands"]:
        packet = config.commands[TARGET][vector["name"]].clone()
        packet.restore_defaults()
        for name, value in {**vector["values"], "SRC_SEQ_CTR": 3, "REQUEST_ID": 9}.items():
            item = packet.get_item(name)
            packet.write(name, bytes.fromhex(value) if item.data_type == "BLOCK" else value)
        packet, compared = checksum.write_packet(length.write_packet(packet)), compared + 1
        if bytes(packet.buffer).hex() != vector["bytes"]:
            problems.append(f"{vector['name']}: {vector['bytes']}, COSMOS writes {bytes(packet.buffer).hex()}")
    print(f"{len(vectors['packets'])} packets, {len(vectors['commands'])} commands: {compared} values compared")
    print("\n".join(problems[:20]) or "all equal, no warnings")
    return 1 if problems else 0


def _equal(got: Any, value: Any) -> bool:
    if isinstance(got, (bytes, bytearray)):
        got = bytes(got).hex()
    return bool(got == value)


def main(arguments: list[str] | None = None) -> int:
    """Run one of the two steps."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n", 1)[0] if __doc__ else "")
    parser.add_argument("step", choices=("write", "read"))
    parser.add_argument("folder", type=Path)
    parser.add_argument("--instrument", default="cubestar")
    chosen = parser.parse_args(arguments)
    return write(chosen.folder, chosen.instrument) if chosen.step == "write" else read(chosen.folder)


if __name__ == "__main__":
    sys.exit(main())
