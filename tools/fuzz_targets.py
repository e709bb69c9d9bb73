"""Fuzz targets: one function for each parser of untrusted bytes. ``fuzz_one(data)`` raises only on a defect.

Contract of every parser under test: it returns a result or raises a GssError that states the problem. It never raises
another exception and never needs much time or memory. The deframer, the packet decoder, the session and the capture
decoder never raise. Formats with checksums are tested twice, unchanged and with corrected checksums, because an
attacker can also compute checksums.
"""

from __future__ import annotations

import hashlib
import io
import json
import struct
import zipfile
import zlib
from collections.abc import Callable
from contextlib import suppress
from datetime import UTC, datetime
from functools import lru_cache
from typing import Any

from gss.catalogue_tools.envelope.orbits import altitude_of_tle, from_tle
from gss.catalogue_tools.formats.registry import blocks_of, decode, encoded_again, part_bytes
from gss.catalogue_tools.formats.table_files import export_table, import_table
from gss.catalogue_tools.formats.triplet_table import decode_triplets
from gss.catalogue_tools.manifest import check_image, manifest_of, read_manifest
from gss.catalogue_tools.onboard import c_source, read_c_source
from gss.catalogue_tools.request import request_from
from gss.catalogue_tools.sources.star_list_mapping import ListMapping
from gss.catalogue_tools.sources.star_lists import read_star_list
from gss.device.protocol import codec
from gss.device.protocol.framing import FRAMINGS, MAX_PACKET_BYTES
from gss.device.protocol.packet import Packet, PacketType
from gss.device.protocol.receiver import Deframer, decode_packet
from gss.device.protocol.sender import LineSender, encode_frame, encode_packet, with_crc
from gss.device.session import HostSession
from gss.device.tables import decode_bad_pixels, decode_table, encode_bad_pixels, encode_table
from gss.domain.errors import GssError
from gss.instruments.dictionary.read_dictionary import load_dictionary, parse_dictionary
from gss.instruments.registry import shipped_camera
from gss.operations.contacts.capture_decoder import CaptureDecoder
from gss.operations.frames.dark_frames import from_bytes
from gss.operations.frames.frame_files import read_frame
from gss.operations.line.raw_capture import read_capture
from tools.fuzz_contract import Target, require
from tools.fuzz_foreign_targets import FOREIGN_TARGETS

MAX_RECORDS = 200
RECORD = struct.Struct(">BBHH")


# --- the line -------------------------------------------------------------------------------------------------------


def frames(data: bytes) -> None:
    """Test each framing: no exception, bounded memory, the same packets for every split of the stream, and equal
    packets after a round trip."""
    step = 1 + (data[0] if data else 0)
    for name in FRAMINGS:
        unsplit, split = Deframer(framing=name), Deframer(framing=name)
        expected = unsplit.feed(data)
        received: list[bytes] = []
        for at in range(0, len(data), step):
            received += split.feed(data[at : at + step])
            require(split.held_bytes <= FRAMINGS[name].limit(MAX_PACKET_BYTES), "a frame exceeds its size limit")
        require(received == expected, "the packets depend on the split of the stream")
        for packet in expected:
            require(
                Deframer(framing=name).feed(encode_frame(packet, name)) == [packet], "the round trip changed a packet"
            )


def packets(data: bytes) -> None:
    """Test the data as a packet, and as a payload with each layout of the dictionary. A decoded packet must be equal
    after a round trip. An encoded payload must be decodable."""
    for candidate in (data, with_crc(data)):
        packet = decode_packet(candidate)
        if isinstance(packet, Packet):
            require(decode_packet(encode_packet(packet)) == packet, "the round trip changed a packet")
    for layout in _layouts():
        with suppress(GssError):
            decoded = codec.decode(layout, data)
            require(
                codec.decode(layout, codec.encode(layout, decoded.raw, decoded.lists)).lists is not None,
                "no lists decoded",
            )


@lru_cache(maxsize=1)
def _layouts() -> list[Any]:
    d = load_dictionary()
    arguments = [c.arguments for c in d.commands] + [c.returns for c in d.commands]
    return [*arguments, *(p.fields for p in d.telemetry if not _converted(p)), *(s.fields for s in d.services)]


def _converted(packet: Any) -> bool:
    return any(field.conversion.coefficients for field in packet.values)


def _records(data: bytes) -> list[tuple[int, int, int, bytes]]:
    """Split the data into records (u8 type, u8 code, u16 request id, u16 length, payload), from which the caller builds
    packets with valid checksums."""
    records: list[tuple[int, int, int, bytes]] = []
    at = 0
    while at + RECORD.size <= len(data) and len(records) < MAX_RECORDS:
        kind, code, request_id, length = RECORD.unpack_from(data, at)
        at += RECORD.size
        payload = data[at : at + min(length, 1900)]
        at += len(payload)
        records.append((list(PacketType)[kind % len(PacketType)], code, request_id, payload))
    return records


def session(data: bytes) -> None:
    """Test the ground session with arbitrary packets while a command and a transfer are in progress."""
    dictionary = load_dictionary()
    host, now_s = HostSession(dictionary), 100.0
    host.link_up(now_s)
    host.feed(data, now_s)
    sender = LineSender(to_device=False, prefix=dictionary.prefix)
    with suppress(GssError):
        host.submit(host.encode("GET_STATUS", {}))
        host.transfers.start_download("frame", 1)
    for kind, code, request_id, payload in _records(data):
        now_s += 0.05
        host.poll(now_s)
        host.feed(sender.packet(PacketType(kind), code, request_id, payload), now_s)
    host.poll(now_s + 100.0)
    host.link_lost(now_s + 101.0)


def capture(data: bytes) -> None:
    """Test the decoder of captures with the data as a capture file, as one record of line bytes, and as packets with
    valid checksums."""
    for file in (data, struct.pack("<dBI", 1.7e9, 0, len(data)) + data):
        decoder = CaptureDecoder(load_dictionary())
        for at_s, direction, piece in read_capture(io.BytesIO(file)):
            decoder.feed(at_s, direction, piece)
    decoder = CaptureDecoder(load_dictionary())
    senders = [LineSender(to_device=up, prefix=load_dictionary().prefix) for up in (False, True)]
    for k, (kind, code, request_id, payload) in enumerate(_records(data)):
        up = int(kind == PacketType.COMMAND)
        decoder.feed(float(k), up, senders[up].packet(PacketType(kind), code, request_id, payload))


# --- files of users -------------------------------------------------------------------------------------------------


def image(data: bytes) -> None:
    """Test an image file: FITS, PNG, TIFF or JPEG, identified by its content."""
    with suppress(GssError):
        frame = read_frame(data, "fuzzed")
        require(frame.pixels.ndim == 2 and frame.pixels.dtype.kind in "uf", "not a two-dimensional image")


def _star_list(kind: str) -> Callable[[bytes], None]:
    def fuzz_one(data: bytes) -> None:
        for mapping in (None, ListMapping(epoch_jyear=2000.0, frame="icrs")):
            with suppress(GssError):
                read_star_list(data, kind, mapping)

    return fuzz_one


def tle(data: bytes) -> None:
    """Test a two-line element set, unchanged and with corrected checksums."""
    text = data.decode("utf-8", "replace")
    for candidate in (text, "\n".join(map(_with_tle_sum, text.splitlines()[:4]))):
        with suppress(GssError):
            altitude_of_tle(candidate)
        with suppress(GssError):
            from_tle(candidate, datetime(2026, 6, 1, tzinfo=UTC), 7.0)


def _with_tle_sum(line: str) -> str:
    if len(line) < 68 or line[0] not in "12":
        return line
    return line[:68] + str(sum(int(c) if c in "0123456789" else c == "-" for c in line[:68]) % 10)


def dictionary(data: bytes) -> None:
    """Test a dictionary."""
    with suppress(GssError):
        parse_dictionary(data.decode("utf-8", "replace"))


def manifest(data: bytes) -> None:
    """Test a catalogue manifest, unchanged and with corrected hash. A parsed manifest must be equal after a round trip,
    and its uses may raise only GssError."""
    text = data.decode("utf-8", "replace")
    for candidate in (text, _with_manifest_sum(text)):
        with suppress(GssError):
            parsed_manifest = read_manifest(candidate)
            require(read_manifest(parsed_manifest.as_json()) == parsed_manifest, "the round trip changed a manifest")
            with suppress(GssError):
                check_image(parsed_manifest, b"")
            with suppress(GssError):
                manifest_of(parsed_manifest.as_dict())
            with suppress(GssError):
                request_from(parsed_manifest.parameters, shipped_camera("cubestar"))


def _with_manifest_sum(text: str) -> str:
    try:
        content = json.loads(text)
        content.pop("manifest_sha256", None)
        plain = json.dumps(content, sort_keys=True, separators=(",", ":"), ensure_ascii=False, allow_nan=False)
        return json.dumps(content | {"manifest_sha256": hashlib.sha256(plain.encode()).hexdigest()})
    except (ValueError, AttributeError, TypeError, RecursionError):
        return text


def bank(data: bytes) -> None:
    """Test a bank image, unchanged and with corrected checksums. The blocks of a parsed image must be the image, and
    its conversions may raise only GssError."""
    for candidate in (data, _with_bank_sums(data)):
        with suppress(GssError):
            decode(candidate)
            part_bytes(candidate)
            image_bytes = b"".join(piece for _, piece in blocks_of(candidate))
            require(candidate.startswith(image_bytes), "the blocks are not the image")
            with suppress(GssError):
                encoded_again(candidate)
            with suppress(GssError):
                c_source(candidate)
            with suppress(GssError):
                export_table(candidate, "csv")


def _with_bank_sums(data: bytes) -> bytes:
    """Return the data with a correct CRC of the body at byte 56, and of the header at byte 60. The body extends to the
    end of the data."""
    if len(data) < 64:
        return data
    fixed = bytearray(data)
    fixed[56:60] = zlib.crc32(data[64:]).to_bytes(4, "little")
    fixed[60:64] = zlib.crc32(bytes(fixed[:60])).to_bytes(4, "little")
    return bytes(fixed)


def device_table(data: bytes) -> None:
    """Test calibration, parameter, bad-pixel and triplet tables, unchanged and with corrected checksums."""
    for candidate in (data, _with_table_sums(data)):
        for kind in ("calibration", "parameters"):
            with suppress(GssError):
                profile, values = decode_table(kind, candidate)
                with suppress(GssError):  # the wire format allows names that the encoder rejects
                    require(
                        decode_table(kind, encode_table(kind, profile, values))[0] == profile,
                        "the round trip changed data",
                    )
        with suppress(GssError):
            name, pixels = decode_bad_pixels(candidate)
            with suppress(GssError):  # the wire format allows names that the encoder rejects
                require(encode_bad_pixels(name, pixels)[64:] == candidate[64:], "the round trip changed data")
        with suppress(GssError):
            decode_triplets(candidate)


def _with_table_sums(data: bytes) -> bytes:
    if len(data) < 64:
        return data
    fixed = bytearray(data)
    if data[:4] == b"GSST":
        end = 64 + 6 * int.from_bytes(data[12:16], "little")
        fixed[56:60] = zlib.crc32(data[64:end]).to_bytes(4, "little")
        fixed[60:64] = zlib.crc32(bytes(fixed[:60])).to_bytes(4, "little")
    else:
        fixed[44:48] = (len(data) - 64).to_bytes(4, "little")
        fixed[56:60] = zlib.crc32(data[64:]).to_bytes(4, "little")
        fixed[60:64] = zlib.crc32(bytes(fixed[:60])).to_bytes(4, "little")
    return bytes(fixed)


def _table_file(kind: str) -> Callable[[bytes], None]:
    def fuzz_one(data: bytes) -> None:
        with suppress(GssError):
            import_table(data, kind)

    return fuzz_one


def _inside_zip(kind: str) -> Callable[[bytes], None]:
    """Return a target that tests a member of a ZIP file. The first line of the input is the name of the member, the
    remainder its content. Mutations of compressed bytes would not find defects of the parser."""

    def fuzz_one(data: bytes) -> None:
        name, _, content = data.partition(b"\n")
        members = dict(_valid_members(kind))
        members[name.decode("ascii", "replace")[:60] or "x"] = content
        file = io.BytesIO()
        with zipfile.ZipFile(file, "w") as archive:
            for member, piece in members.items():
                archive.writestr(zipfile.ZipInfo(member), piece)
        with suppress(GssError):
            import_table(file.getvalue(), kind)

    return fuzz_one


@lru_cache(maxsize=3)
def _valid_members(kind: str) -> tuple[tuple[str, bytes], ...]:
    from tools.fuzz_seeds import small_bank

    with zipfile.ZipFile(io.BytesIO(export_table(small_bank(), kind))) as archive:
        return tuple((name, archive.read(name)) for name in archive.namelist())


def c_sources(data: bytes) -> None:
    """Test a catalogue as C source."""
    with suppress(GssError):
        read_c_source(data.decode("utf-8", "replace"))


def dark_frame(data: bytes) -> None:
    """Test a stored dark frame."""
    with suppress(GssError):
        from_bytes(data)


TARGETS: dict[str, Target] = {
    "frames": Target(frames, max_bytes=8192),
    "packets": Target(packets, max_bytes=4096),
    "session": Target(session, max_bytes=8192),
    "capture": Target(capture),
    "image": Target(image),
    "star-list-csv": Target(_star_list("csv"), text=True),
    "star-list-ecsv": Target(_star_list("ecsv"), text=True),
    "star-list-votable": Target(_star_list("votable"), text=True),
    "star-list-fits": Target(_star_list("fits")),
    "tle": Target(tle, text=True, max_bytes=1024),
    "dictionary": Target(dictionary, text=True),
    "manifest": Target(manifest, text=True),
    "bank": Target(bank, max_bytes=1 << 14),
    "device-table": Target(device_table, max_bytes=8192),
    "table-fits": Target(_table_file("fits")),
    "table-zip": Target(_table_file("csv")),
    "table-csv": Target(_inside_zip("csv"), text=True),
    "table-ecsv": Target(_inside_zip("ecsv"), text=True),
    "table-parquet": Target(_inside_zip("parquet")),
    "c-source": Target(c_sources, text=True),
    "dark-frame": Target(dark_frame),
} | FOREIGN_TARGETS
