"""Write the seeds of fuzzing: ``python -m tools.fuzz_seeds`` rewrites the seeds in tests/fuzz/corpus and keeps the
regressions.

The seeds are small valid examples created by the writers of GSS. Failing inputs from fuzzing are stored in the same
folder as ``regression-*``.
"""

from __future__ import annotations

import io
import json
import struct
import zipfile
from collections.abc import Iterator
from datetime import UTC, datetime
from functools import lru_cache
from pathlib import Path

import numpy as np

from gss.catalogue_tools.envelope.attitude import AttitudeLimits
from gss.catalogue_tools.formats.table_files import export_table
from gss.catalogue_tools.formats.triplet_table import encode_triplets, triplets_of
from gss.catalogue_tools.manifest import BuildManifest
from gss.catalogue_tools.onboard import FORMATS, c_source, encode
from gss.catalogue_tools.request import BuildRequest, TleOrbit, parameters_of
from gss.catalogue_tools.selection.selection import SelectionRules
from gss.catalogue_tools.sources.hipparcos import load_stars, propagate
from gss.catalogue_tools.sources.star_list_export import write_star_list
from gss.device.protocol.packet import Packet, PacketType
from gss.device.protocol.receiver import LineReceiver
from gss.device.protocol.sender import encode_frame, encode_packet
from gss.device.session import HostSession
from gss.device.simulator.factory import burn_golden
from gss.device.simulator.firmware import StarTracker
from gss.device.simulator.machine import Identity, SimulatedDevice
from gss.device.simulator.memory import Memory
from gss.device.simulator.orbit import Inertial
from gss.device.simulator.sky import SimulatedSky
from gss.device.tables import encode_bad_pixels, encode_table
from gss.instruments.dictionary.read_dictionary import load_dictionary
from gss.instruments.golden import build_golden
from gss.instruments.registry import shipped_camera
from gss.operations.frames.dark_frames import as_bytes
from gss.pipeline.fixed_pattern import DarkPattern
from gss.skytables.pairs import distance_table
from gss.skytables.triplets import TripletClasses
from tools.fuzz_foreign_seeds import TLE, foreign_seeds

CORPUS = Path(__file__).parent.parent / "tests" / "fuzz" / "corpus"
DICTIONARY = """version: 1
device_model: X
enums: {onoff: [{name: "off", value: 0}, {name: "on", value: 1, hazard: warning}]}
limit_sets: [{name: eclipse, note: n}]
commands:
- {name: GO, code: 1, subsystem: s, purpose: p, idempotent: true, accept_s: 1, complete_s: 2, hazard: critical, hazard_reason: r,
   arguments: [{name: a, type: u8, min: 0, max: 9, default: 1}, {name: b, type: enum, enum: onoff}],
   returns: [{name: rows, list: [{name: v, type: f32}]}], preconditions: [{field: t, op: lt, value: 3, text: x}]}
telemetry:
- {name: housekeeping, code: 1, purpose: p, stale_after_s: 5, fields: [
   {name: t, type: i16, unit: °C, conversion: {linear: [0.1, 2]}, watch: [0, 5], critical: [-9, null], persistence: 2,
    sets: {eclipse: {watch: [1, 2]}}}]}
events: [{name: BOOT, code: 1, severity: ok, purpose: p}]
services: [{name: CHUNK, packet: transfer, code: 4, purpose: p, fields: [{name: data, type: rest}]}]
"""


@lru_cache(maxsize=8)
def small_bank(format_name: str = "cubestar") -> bytes:
    """Return a bank with stars to V 0.8 and all their pairs, in one of the on-board formats."""
    stars = propagate(load_stars(0.8), 2026.0)
    return encode(stars, distance_table(stars, 0.01, 0.4), format_name, "cubestar")


@lru_cache(maxsize=1)
def _contact() -> tuple[list[tuple[float, int, bytes]], list[Packet]]:
    """Return a minute of traffic between a simulated sensor and the ground, as capture records and as downlink
    packets."""
    camera, memory = shipped_camera("cubestar"), Memory.in_ram()
    burn_golden(memory, camera, build_golden(camera, memory.bank_bytes))
    motion = Inertial.pointing(1.4661, 0.0873, 0.3)
    tracker, now_s = StarTracker(camera, SimulatedSky(camera, motion, 2026.0, 1), memory), 100.0
    device, host = (
        SimulatedDevice(load_dictionary(), Identity(), memory, tracker, now_s),
        HostSession(load_dictionary()),
    )
    host.link_up(now_s)
    receiver, stream, packets = LineReceiver(from_device=True), [], []
    for step in range(1200):
        now_s += 0.05
        up, _ = host.poll(now_s)
        device.advance(now_s)
        device.feed(up, now_s)
        frame = device.next_frame(now_s) or b""
        host.feed(frame, now_s)
        stream += [(1.7e9 + now_s, direction, data) for direction, data in ((1, up), (0, frame)) if data]
        packets += receiver.feed(frame)
        if step == 20:
            host.submit(host.encode("GET_STATUS", {}))
            host.submit(host.encode("TAKE_IMAGE", {}))
        if step == 200:
            host.transfers.start_download("frame", 1)
    return stream, packets


def _records(packets: list[Packet]) -> bytes:
    kinds = list(PacketType)
    heads = (struct.pack(">BBHH", kinds.index(p.type), p.code, p.request_id, len(p.payload)) for p in packets)
    return b"".join(head + p.payload for head, p in zip(heads, packets, strict=True))


def _pictures() -> Iterator[tuple[str, bytes]]:
    from astropy.io import fits
    from PIL import Image

    pixels = (np.indices((12, 16)).sum(axis=0) * 7).astype(np.uint8)
    exif = Image.Exif()
    exif[0x0132] = "2026:01:02 03:04:05"
    for name, mode, options in (
        ("png", "L", {}),
        ("png", "RGBA", {}),
        ("png", "P", {}),
        ("jpeg", "RGB", {"exif": exif}),
        ("tiff", "L", {"compression": "tiff_lzw"}),
        ("tiff", "RGB", {}),
        ("tiff", "I;16", {}),
    ):
        file = io.BytesIO()
        picture = (
            Image.fromarray(pixels.astype(np.uint16) << 4) if mode == "I;16" else Image.fromarray(pixels).convert(mode)
        )
        picture.save(file, name, **options)
        yield f"{mode.lower().replace(';', '')}.{name}", file.getvalue()
    for kind in (np.int16, np.float32):
        hdu = fits.PrimaryHDU(pixels.astype(kind))
        hdu.header.update({"EXPTIME": 0.5, "DATE-OBS": "2026-01-02T03:04:05", "INSTRUME": "X"})
        file = io.BytesIO()
        hdu.writeto(file)
        yield f"{np.dtype(kind).name}.fits", file.getvalue()
    file = io.BytesIO()
    fits.HDUList([fits.PrimaryHDU(), fits.CompImageHDU(np.tile(pixels, (2, 2)))]).writeto(file)
    yield "packed.fits", file.getvalue()


def _request() -> BuildRequest:
    limits = AttitudeLimits("zenith")
    start = datetime(2026, 1, 1, tzinfo=UTC)
    return BuildRequest(
        shipped_camera("cubestar"), "cubestar", SelectionRules(3.0), orbit=TleOrbit(TLE), attitude=limits, start=start
    )


def _manifest() -> str:
    request = json.loads(json.dumps(parameters_of(_request())))
    return BuildManifest(
        name="n",
        author="a",
        tool="t",
        format_name="cubestar",
        profile_name="cubestar",
        profile_sha256="0" * 64,
        source="s",
        star_table_sha256="0" * 64,
        frame="icrs",
        epoch_jyear=2026.0,
        valid_from="2026-01-01T00:00:00Z",
        valid_to="",
        parameters=request,
        envelope={"k": 1.5},
        counts={"stars": 2},
        bytes_by_part={"header": 64},
        quality={"q": None},
        quantisation={"p": None},
        hip=(1, 2),
        image_sha256="0" * 64,
    ).as_json()


def seeds() -> Iterator[tuple[str, str, bytes]]:
    """Yield (target, name, bytes) of each seed."""
    stream, packets = _contact()
    line = b"".join(data for _, direction, data in stream if direction == 0)[:6000]
    yield "frames", "contact-cobs", line
    yield "frames", "contact-slip", b"".join(encode_frame(encode_packet(p), "slip") for p in packets[:8])
    for kind in PacketType:
        for p in [p for p in packets if p.type is kind][:2]:
            yield "packets", f"{kind.name.lower()}-{p.code}", encode_packet(p)
            yield "packets", f"payload-{kind.name.lower()}-{p.code}", p.payload
    yield "session", "greeted", _records(packets[:12])
    transfer = [p for p in packets if p.type in (PacketType.TRANSFER, PacketType.REPORT)]
    yield "session", "transfer", _records([p for p in transfer if len(p.payload) < 300][:20])
    for name, part in (("contact", stream[:40]), ("middle", stream[200:230])):
        yield (
            "capture",
            name,
            b"".join(struct.pack("<dBI", s, direction, len(d)) + d for s, direction, d in part)[:8000],
        )
    yield "capture", "records", _records(packets[:12])
    for name, data in _pictures():
        yield "image", name, data
    few = propagate(load_stars(0.3), 2026.0)
    for form in ("csv", "ecsv", "votable", "fits"):
        yield f"star-list-{form}", "bright", write_star_list(few, form)
    yield (
        "star-list-csv",
        "semicolon",
        b"# epoch = J2000\n# frame: FK5\nname;RA;Dec;V\nx;12:34:56;-1 2 3;1.5\ny;1:2:3;4 5 6;2\n",
    )
    yield "tle", "satellite", TLE.encode()
    yield "tle", "named", b"ISS\n" + TLE.encode()
    yield "dictionary", "small", DICTIONARY.encode()
    yield "manifest", "version-2", _manifest().encode()
    for name in FORMATS:
        yield "bank", name, small_bank(name)
    values: dict[str, str | float] = {"distortion": "brown", "focal_length_px": 1000.0, "k1": -0.1}
    yield "device-table", "calibration", encode_table("calibration", "cubestar", values)
    yield "device-table", "parameters", encode_table("parameters", "cubestar", {"chain": "cubestar", "threshold": 30.0})
    yield "device-table", "bad-pixels", encode_bad_pixels("cubestar", np.array([[300, 200], [7, 9]], np.intp))
    yield "device-table", "triplets", _triplets()
    yield "table-fits", "bank", export_table(small_bank(), "fits")
    yield "table-zip", "bank", export_table(small_bank(), "csv")
    for form in ("csv", "ecsv", "parquet"):
        with zipfile.ZipFile(io.BytesIO(export_table(small_bank(), form))) as archive:
            for member in archive.namelist():
                if member.startswith(("layout", "stars")):
                    yield f"table-{form}", member.partition(".")[0], member.encode() + b"\n" + archive.read(member)
    yield "c-source", "bank", c_source(small_bank()).encode()
    flat = DarkPattern(np.zeros((8, 8), np.float32), np.array([[3, 1]], np.intp), 0.5)
    yield "dark-frame", "flat", as_bytes(flat)
    yield from foreign_seeds()


def _triplets() -> bytes:
    stars = propagate(load_stars(1.2), 2026.0)
    return encode_triplets(triplets_of(stars, TripletClasses.of(2e-4), 0.7, 0.6))


def main() -> None:
    """Write the seeds."""
    for target, name, data in seeds():
        folder = CORPUS / target
        folder.mkdir(parents=True, exist_ok=True)
        (folder / f"seed-{name}").write_bytes(data)
    print(json.dumps({p.name: len(list(p.iterdir())) for p in sorted(CORPUS.iterdir()) if p.is_dir()}))


if __name__ == "__main__":
    main()
