"""A ground station written from docs/icd.md alone. It imports nothing of gss and reads all layouts from the tables of the document.

It shows that the document is sufficient: what this client cannot do with it, a firmware team cannot do either.
"""

from __future__ import annotations

import hashlib
import re
import socket
import struct
import time
import zlib
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

NUMBERS = {"u8": "B", "u16": "H", "u32": "I", "i8": "b", "i16": "h", "i32": "i", "f32": "f", "f64": "d"}
COMMAND, REPORT, TELEMETRY, EVENT, TRANSFER = 1, 2, 3, 4, 5
Values = dict[str, Any]


def cobs_encode(data: bytes) -> bytes:
    out = bytearray()
    for block in (data + b"\0").split(b"\0")[:-1]:
        while len(block) >= 254:
            out += b"\xff" + block[:254]
            block = block[254:]
        out += bytes([len(block) + 1]) + block
    return bytes(out)


def cobs_decode(data: bytes) -> bytes:
    out, at = bytearray(), 0
    while at < len(data):
        code = data[at]
        out += data[at + 1 : at + code]
        at += code
        if code < 255 and at < len(data):
            out.append(0)
    return bytes(out)


@dataclass
class Row:
    """A field of a table. ``choices``: name to number. ``items``: rows of a list."""

    name: str
    type: str
    choices: dict[str, int] = field(default_factory=dict)
    items: list[Row] = field(default_factory=list)


@dataclass
class Section:
    """A command, packet or message of the document: its code, and the rows of its tables by the word before them."""

    name: str
    code: int
    tables: dict[str, list[Row]] = field(default_factory=dict)


class Document:
    """The tables of docs/icd.md."""

    def __init__(self, path: Path) -> None:
        text = path.read_text()
        self.hash = bytes.fromhex(re.search(r"SHA-256 `([0-9a-f]{64})`", text)[1])  # type: ignore[index]
        self.sections: dict[str, Section] = {}
        for head, code, body in re.findall(
            r"^### (\w+) \(.*?code (\d+)\)\n(.*?)(?=^##|\Z)", text, re.MULTILINE | re.DOTALL
        ):
            section = self.sections[head] = Section(head, int(code))
            title = "fields"
            for line in body.splitlines():
                named = re.match(r"(Returns|List (\w+)):", line)
                title = (named[2] or "returns") if named else title
                cells = [c.strip() for c in line.strip("|").split(" | ")]
                if line.startswith("| ") and cells[0] not in ("field", "argument"):
                    self._add(section.tables.setdefault(title, []), cells)

    @staticmethod
    def _add(rows: list[Row], cells: list[str]) -> None:
        choices = {m[1]: int(m[0]) for m in re.findall(r"(\d+) ([A-Za-z]\w*)", " ".join(cells[2:]))}
        row = Row(cells[0].removeprefix("— "), cells[1], choices if cells[1] == "enum" else {})
        (rows[-1].items if cells[0].startswith("— ") else rows).append(row)


def put(rows: list[Row], values: Values) -> bytes:
    out = b""
    for row in rows:
        value, sized = values.get(row.name, 0), re.fullmatch(r"(str|bytes)(\d+)", row.type)
        if row.type in NUMBERS:
            out += struct.pack(">" + NUMBERS[row.type], value)
        elif row.type == "enum":
            out += bytes([row.choices[value]])
        elif row.type == "bool":
            out += bytes([bool(value)])
        elif row.type == "rest":
            out += value
        elif row.type == "text":
            out += bytes([len(value)]) + value
        elif row.type == "list":
            out += bytes([len(value)]) + b"".join(put(row.items, v) for v in value)
        elif sized:
            raw = value.encode() if isinstance(value, str) else value or b""
            out += raw.ljust(int(sized[2]), b"\0")
    return out


def get(rows: list[Row], data: bytes) -> tuple[Values, bytes]:
    """Return the values and the bytes that follow them."""
    values: Values = {}
    for row in rows:
        sized = re.fullmatch(r"(str|bytes)(\d+)", row.type)
        if row.type in NUMBERS:
            size = struct.calcsize(NUMBERS[row.type])
            (values[row.name],), data = struct.unpack(">" + NUMBERS[row.type], data[:size]), data[size:]
        elif row.type in ("enum", "bool"):
            names = {number: name for name, number in row.choices.items()}
            values[row.name], data = names.get(data[0], data[0]) if names else bool(data[0]), data[1:]
        elif row.type == "rest":
            values[row.name], data = data, b""
        elif row.type == "text":
            values[row.name], data = data[1 : 1 + data[0]].decode(), data[1 + data[0] :]
        elif row.type == "list":
            count, data, entries = data[0], data[1:], []
            for _ in range(count):
                entry, data = get(row.items, data)
                entries.append(entry)
            values[row.name] = entries
        elif sized:
            raw, data = data[: int(sized[2])], data[int(sized[2]) :]
            values[row.name] = raw.rstrip(b"\0").decode() if sized[1] == "str" else raw
    return values, data


@dataclass
class Received:
    """A packet of the device: packet type, code, request id, payload."""

    type: int
    code: int
    request_id: int
    payload: bytes


class CleanRoomClient:
    """One connection to a device over TCP. Calls wait for their answer, at most 30 s."""

    def __init__(self, document: Path, host: str, port: int) -> None:
        self.icd = Document(document)
        self._socket = socket.create_connection((host, port), 10)
        self._socket.settimeout(0.05)
        self._buffer = b""
        self._unread: list[Received] = []
        self._framed = False
        self._counts: Counter[int] = Counter()
        self._next_id = 1
        self.packets: list[Received] = []
        self.damaged = 0

    def close(self) -> None:
        self._socket.close()

    # --- packets ------------------------------------------------------------------------------------------------

    def send(self, kind: int, code: int, request_id: int, payload: bytes) -> None:
        """Send one packet (clauses 1.2 and 2.1 to 2.4)."""
        body = bytes([kind, code]) + self.icd.hash[:2] + struct.pack(">IIH", request_id, 0, 0) + payload
        first, count = 1 << 12 | 1 << 11 | (0x100 + kind), 3 << 14 | self._counts[kind] % (1 << 14)
        packet = struct.pack(">HHH", first, count, len(body) + 4 - 1) + body
        self._counts[kind] += 1
        self._socket.sendall(b"\0" + cobs_encode(packet + struct.pack(">I", zlib.crc32(packet))) + b"\0")

    def receive(self) -> list[Received]:
        """Return the packets that have arrived and that no call has looked at, and keep them in ``packets``."""
        if self._unread:
            unread, self._unread = self._unread, []
            return unread
        try:
            self._buffer += self._socket.recv(65536)
        except TimeoutError:
            return []
        *frames, self._buffer = self._buffer.split(b"\0")
        if not self._framed and frames:
            self._framed, frames = True, frames[1:]
        new = []
        for frame in filter(None, frames):
            packet = cobs_decode(frame)
            if len(packet) < 24 or zlib.crc32(packet[:-4]) != int.from_bytes(packet[-4:], "big"):
                self.damaged += 1
                continue
            new.append(Received(packet[6], packet[7], int.from_bytes(packet[10:14], "big"), packet[20:-4]))
        self.packets += new
        return new

    def wait(self, wanted: Any, seconds: float = 30.0) -> Received:
        """Return the first new packet for which ``wanted`` is true."""
        limit_s = time.monotonic() + seconds
        while time.monotonic() < limit_s:
            packets = self.receive()
            for k, packet in enumerate(packets):
                if wanted(packet):
                    self._unread = packets[k + 1 :]
                    return packet
        raise TimeoutError(f"no answer; last packets {self.packets[-5:]}")

    def take_id(self) -> int:
        self._next_id += 1
        return self._next_id - 1

    # --- commands -----------------------------------------------------------------------------------------------

    def command(self, name: str, wait_s: float = 30.0, **arguments: Any) -> Values:
        """Send a command and return its last report with the returned values."""
        section, request_id = self.icd.sections[name], self.take_id()
        self.send(COMMAND, section.code, request_id, put(section.tables.get("fields", []), arguments))

        def ended(packet: Received) -> bool:
            return (
                packet.type == REPORT
                and packet.request_id == request_id
                and self.report(packet)["stage"] in ("completed", "failed", "rejected")
            )

        report, rest = get(self.icd.sections["REPORT"].tables["fields"], self.wait(ended, wait_s).payload)
        returned = get(section.tables["returns"], rest)[0] if rest and "returns" in section.tables else {}
        return report | returned

    def report(self, packet: Received) -> Values:
        return get(self.icd.sections["REPORT"].tables["fields"], packet.payload)[0]

    def hello(self) -> Values:
        """Identify the device, which ignores bytes while it boots, and continue above its highest request id (clause 3.4)."""
        for _ in range(5):
            try:
                values = self.command("HELLO", wait_s=3.0)
                break
            except TimeoutError:
                continue
        self._next_id = max(self._next_id, values["last_request_id"] + 1)
        return values

    def telemetry(self, name: str) -> Values:
        """Return the newest packet of that name."""
        section = self.icd.sections[name]
        newest = next(p for p in reversed(self.packets) if (p.type, p.code) == (TELEMETRY, section.code))
        return get(section.tables["fields"], newest.payload)[0]

    # --- transfers ----------------------------------------------------------------------------------------------

    def message(self, name: str, request_id: int, **values: Any) -> None:
        section = self.icd.sections[name]
        self.send(TRANSFER, section.code, request_id, put(section.tables["fields"], values))

    def answer(self, request_id: int, *names: str) -> tuple[str, Values]:
        """Return name and values of the next of these messages; also ABORT_TRANSFER, which is an error."""
        codes = {self.icd.sections[name].code: name for name in (*names, "ABORT_TRANSFER")}
        packet = self.wait(lambda p: p.type == TRANSFER and p.request_id == request_id and p.code in codes)
        values = get(self.icd.sections[codes[packet.code]].tables["fields"], packet.payload)[0]
        if codes[packet.code] == "ABORT_TRANSFER":
            raise RuntimeError(f"{values['reason']}: {values['detail']}")
        return codes[packet.code], values

    def download(self, kind: str, target: int) -> bytes:
        """Return the content (clauses 6.1 to 6.5, 6.19, 6.20)."""
        request_id = self.take_id()
        self.message("OPEN_DOWNLOAD", request_id, kind=kind, target=target, chunk_bytes=1024)
        _, opened = self.answer(request_id, "OPENED")
        size, session, count = (
            opened["chunk_bytes"],
            opened["session"],
            -(-opened["size_bytes"] // opened["chunk_bytes"]),
        )
        held: dict[int, bytes] = {}
        serial = since = 0
        chunks = self.icd.sections["CHUNK"]

        def status() -> None:
            runs: list[list[int]] = []
            for index in sorted(held):
                if runs and runs[-1][1] == index - 1:
                    runs[-1][1] = index
                elif len(runs) < 16:
                    runs.append([index, index])
                else:
                    break
            end = count if len(runs) < 16 else runs[-1][1] + 1
            ranges = [{"first": a, "last": b} for a, b in runs]
            page = {"serial": serial, "stored_chunks": len(held), "from_index": 0, "to_index": end, "ranges": ranges}
            self.message("STATUS", request_id, session=session, **page)

        status()
        limit_s = time.monotonic() + 60
        while len(held) < count:
            assert time.monotonic() < limit_s, f"{len(held)} of {count} chunks"
            for packet in self.receive():
                if packet.type != TRANSFER or packet.request_id != request_id:
                    continue
                if packet.code == chunks.code:
                    values = get(chunks.tables["fields"], packet.payload)[0]
                    held[values["index"]], serial, since = values["data"], max(serial, values["serial"]), since + 1
                    if since >= max(1, opened["window_chunks"] // 4):
                        status()
                        since = 0
                elif packet.code == self.icd.sections["STATUS_REQUEST"].code:
                    request = get(self.icd.sections["STATUS_REQUEST"].tables["fields"], packet.payload)[0]
                    serial = max(serial, request["serial"])
                    status()
        status()
        self.message("CLOSE", request_id, session=session)
        data = b"".join(held[i] for i in range(count))
        assert len(data) == opened["size_bytes"]
        assert max(map(len, held.values())) <= size
        assert hashlib.sha256(data).digest() == opened["sha256"]
        return data

    def upload(self, kind: str, target: int, data: bytes, facts: Values) -> None:
        """Upload, verify and commit content (clauses 6.2, 6.3, 6.7)."""
        request_id, digest = self.take_id(), hashlib.sha256(data).digest()
        opening = {"kind": kind, "target": target, "size_bytes": len(data), "chunk_bytes": 1024, "sha256": digest}
        self.message("OPEN_UPLOAD", request_id, **opening, **facts)
        _, opened = self.answer(request_id, "OPENED")
        size, session = opened["chunk_bytes"], opened["session"]
        missing, serial = set(range(-(-len(data) // size))), 0
        while missing:
            for index in sorted(missing)[: opened["window_chunks"]]:
                serial += 1
                piece = data[index * size : (index + 1) * size]
                self.message("CHUNK", request_id, session=session, index=index, serial=serial, data=piece)
            self.message("STATUS_REQUEST", request_id, session=session, serial=serial, from_index=0)
            page: Values = {"serial": -1}
            while page["serial"] < serial:
                _, page = self.answer(request_id, "STATUS")
            for run in page["ranges"]:
                missing -= set(range(run["first"], run["last"] + 1))
        self.message("VERIFY", request_id, session=session)
        _, verified = self.answer(request_id, "VERIFIED")
        assert verified["equal"]
        assert verified["sha256"] == digest
        self.message("COMMIT", request_id, session=session)
        self.answer(request_id, "COMMITTED")
