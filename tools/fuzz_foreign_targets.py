"""Fuzz targets for files and bytes of other systems: messages, packages, procedures, star lists, drivers.

The contract is that of ``tools.fuzz_targets``: a result or a GssError. Drivers never raise on bytes of the line.
"""

from __future__ import annotations

import io
import struct
import zipfile
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import lru_cache

import numpy as np

from gss.device.can_frames import CanFrame, CanReader
from gss.device.driver import open_driver
from gss.device.link_framing import DelimitedFramer
from gss.device.sagitta_driver import packet
from gss.domain.errors import GssError
from gss.instruments.dictionary.read_dictionary import load_dictionary
from gss.instruments.dictionary.read_xtce import read_xtce
from gss.instruments.package import Instrument, load_instrument
from gss.instruments.package_source import read_zip, write_zip
from gss.instruments.registry import shipped_registry
from gss.instruments.roles import default_roles
from gss.operations.frames.measured_list_files import read_star_lists
from gss.operations.procedures.document import read_procedure
from gss.operations.procedures.validation import mistakes_of
from gss.orbit.objects import read_objects
from gss.orbit.read_attitude import read_attitude_file
from gss.orbit.read_orbit import read_orbits
from tools.fuzz_contract import Target, require

SAGITTA_RECORD = struct.Struct(">BBB")
CAN_RECORD = struct.Struct(">HB")
MAX_RECORDS = 60
STEP_S = 0.4


def attitude_message(data: bytes) -> None:
    """Test an attitude message, AEM or ACM."""
    with suppress(GssError):
        history = read_attitude_file(data)
        require(len(history.times_s) == len(history.quaternions), "times and attitudes differ in number")


def orbit_message(data: bytes) -> None:
    """Test an orbit file: OEM, OMM in three notations, or element sets. Each orbit gives a position or an error."""
    text = data.decode("utf-8", "replace")
    with suppress(GssError):
        read_objects(text)
    with suppress(GssError):
        for orbit in read_orbits(text)[:3]:
            with suppress(GssError):
                orbit.teme_km(np.array([orbit.epoch.timestamp()]))


def xtce(data: bytes) -> None:
    """Test an XTCE document."""
    with suppress(GssError):
        read_xtce("fuzzed.xml", data)


def package(data: bytes) -> None:
    """Test a package. The first line of the input is the name of the shipped package and of the file that is replaced,
    the remainder the content of this file."""
    head, _, content = data.partition(b"\n")
    name, _, file = head.decode("utf-8", "replace").partition("/")
    files = dict(_shipped(name if name in ("aim", "nos3", "oresat") else "aim").files)
    files[file[:80]] = content
    with suppress(GssError):
        load_instrument(read_zip(write_zip("fuzzed", files)))


def package_zip(data: bytes) -> None:
    """Test the bytes of a zip file."""
    with suppress(GssError):
        load_instrument(read_zip(data))


def procedure(data: bytes) -> None:
    """Test the text of a procedure, and its validation."""
    dictionary = load_dictionary()
    with suppress(GssError):
        document = read_procedure(data.decode("utf-8", "replace"))
        mistakes_of(document, default_roles(dictionary).operations, dictionary)


def measured_lists(data: bytes) -> None:
    """Test a file of measured stars. The input is also tested as each array of an .npz file."""
    with suppress(GssError):
        read_star_lists(data, "fuzzed")
    for member in ("first.npy", "flux.npy"):
        with suppress(GssError):
            read_star_lists(_with_member(member, data), "fuzzed")


def _with_member(member: str, data: bytes) -> bytes:
    from tools.fuzz_foreign_seeds import measured_npz

    out = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(measured_npz())) as valid, zipfile.ZipFile(out, "w") as changed:
        for name in valid.namelist():
            changed.writestr(zipfile.ZipInfo(name), data if name == member else valid.read(name))
    return out.getvalue()


def driver(name: str) -> Callable[[bytes], None]:
    """Return a target that feeds bytes to the driver of a shipped instrument while its requests are in progress: first
    unchanged, then as packets with correct checksums."""

    def fuzz_one(data: bytes) -> None:
        for pieces in ([data], _sagitta_frames(data) if name == "sagitta" else _can_records(data)):
            session, now_s = open_driver(_shipped(name)), 10.0
            session.link_up(now_s)
            for piece in pieces:
                session.poll(now_s)
                session.feed(piece, now_s)
                now_s += STEP_S
            session.poll(now_s + 100.0)
            session.link_lost(now_s + 101.0)

    return fuzz_one


def can_records(data: bytes) -> None:
    """Test the reader of CAN records: the frames do not depend on the split of the stream, and are valid records."""
    unsplit, split = CanReader(), CanReader()
    step = 1 + (data[0] if data else 0)
    frames = [frame for at in range(0, len(data), step) for frame in split.feed(data[at : at + step])]
    require(unsplit.feed(data) == frames, "the frames depend on the split of the stream")
    again = CanReader()
    require(again.feed(b"".join(frame.record() for frame in frames)) == frames, "the round trip changed a frame")


def _sagitta_frames(data: bytes) -> Iterator[bytes]:
    """Yield packets with correct hashes from records of type, number, length and content."""
    framer, at = DelimitedFramer("slip"), 0
    for _ in range(MAX_RECORDS):
        if at + SAGITTA_RECORD.size > len(data):
            return
        kind, number, length = SAGITTA_RECORD.unpack_from(data, at)
        at += SAGITTA_RECORD.size
        yield framer.encode(packet(kind, number, data[at : at + length]))
        at += length


def _can_records(data: bytes) -> Iterator[bytes]:
    """Yield CAN records from records of identifier, length and content."""
    at = 0
    for _ in range(MAX_RECORDS):
        if at + CAN_RECORD.size > len(data):
            return
        identifier, length = CAN_RECORD.unpack_from(data, at)
        at += CAN_RECORD.size
        yield CanFrame(identifier & 0x7FF, data[at : at + min(length, 8)]).record()
        at += min(length, 8)


@lru_cache(maxsize=4)
def _shipped(name: str) -> Instrument:
    return shipped_registry().get(name)


FOREIGN_TARGETS: dict[str, Target] = {
    "attitude-message": Target(attitude_message, text=True),
    "orbit-message": Target(orbit_message, text=True, max_bytes=8192),
    "xtce": Target(xtce, text=True),
    "package": Target(package, text=True),
    "package-zip": Target(package_zip),
    "procedure": Target(procedure, text=True, max_bytes=8192),
    "measured-lists": Target(measured_lists, text=True),
    "can-records": Target(can_records, max_bytes=4096),
    "sagitta": Target(driver("sagitta"), max_bytes=4096),
    "oresat": Target(driver("oresat"), max_bytes=4096),
}
