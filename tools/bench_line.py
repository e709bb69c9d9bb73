"""Measure packet encoding and decoding rates, and transfer efficiency on the line."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gss.catalogue_tools.onboard import HEADER_VERSION, read_header
from gss.device.protocol.codec import Lists, decode, encode
from gss.device.protocol.packet import PacketType
from gss.device.protocol.receiver import LineReceiver
from gss.device.protocol.sender import LineSender
from gss.device.protocol.transfer import Compatibility
from gss.device.session import HostSession
from gss.device.session_events import CommandUpdate, SessionEvent, Stage, TransferUpdate
from gss.device.simulator.factory import burn_golden
from gss.device.simulator.faults import FaultRates, LineFaults
from gss.device.simulator.firmware import StarTracker
from gss.device.simulator.machine import Identity, SimulatedDevice
from gss.device.simulator.memory import Memory
from gss.device.simulator.orbit import Inertial
from gss.device.simulator.sky import SimulatedSky
from gss.instruments.dictionary.definitions import Dictionary, Layout, Values
from gss.instruments.dictionary.read_dictionary import load_dictionary
from gss.instruments.golden import Golden, build_golden
from gss.instruments.registry import shipped_camera
from tools.bench_tables import BenchTable, Value, repeated_ms, timed_ms

SEED = 1
STEP_S = 0.01
TIMEOUT_S = 1500.0
BITS_PER_BYTE = 10
BAUDS = (115_200, 921_600)
ERROR_RATES = (0.0, 1e-6, 1e-5, 1e-4)


@dataclass(frozen=True)
class Kind:
    """Packet type with the content that is sent repeatedly."""

    type: PacketType
    code: int
    layout: Layout
    values: Values
    lists: Lists


def packets(quick: bool) -> list[BenchTable]:
    """Return packets per second on one core, for encoding, for decoding and for both in sequence."""
    dictionary, count = load_dictionary(), 50 if quick else 2000
    rng = np.random.default_rng(SEED)
    chunk, matches = dictionary.service("CHUNK"), dictionary.packet("matches")
    stars: list[Values] = [{"centroid": i, "star": int(rng.integers(400)), "weight": float(i)} for i in range(20)]
    kinds = {
        "CHUNK, 1024 B": Kind(
            PacketType.TRANSFER,
            chunk.code,
            chunk.fields,
            {"session": 1, "index": 7, "serial": 9, "data": rng.bytes(1024)},
            {},
        ),
        "matches, 20 stars": Kind(
            PacketType.TELEMETRY, matches.code, matches.fields, {"frame_number": 3}, {"items": stars}
        ),
    }
    rows = [(label, _packet_rates(kind, dictionary.prefix, count)) for label, kind in kinds.items()]
    conditions = f"{count} packets per batch, values to framed bytes and back, CRC-32 checked; median of five runs."
    return [BenchTable("packets", "Packet encoding and decoding", conditions, SEED, rows)]


def _packet_rates(kind: Kind, prefix: int, count: int) -> dict[str, Value]:
    sender = LineSender(to_device=False, prefix=prefix)

    def send() -> bytes:
        frames = (
            sender.packet(kind.type, kind.code, 1, encode(kind.layout, kind.values, kind.lists)) for _ in range(count)
        )
        return b"".join(frames)

    def receive() -> int:
        packets = LineReceiver(from_device=True).feed(stream)
        return sum(bool(decode(kind.layout, packet.payload).values) for packet in packets)

    stream = send()
    assert receive() == count  # noqa: S101 - the rate is meaningless if packets are lost
    encode_ms = float(np.median(repeated_ms(send, 5)))
    decode_ms = float(np.median(repeated_ms(receive, 5)))
    return {
        "bytes": len(stream) // count,
        "encode_per_s": round(1e3 * count / encode_ms),
        "decode_per_s": round(1e3 * count / decode_ms),
        "through_per_s": round(1e3 * count / (encode_ms + decode_ms)),
        "through_MB_per_s": len(stream) / 1e3 / (encode_ms + decode_ms),
    }


class SimulatedLine:
    """Ground session and simulated device on a line with a given baud rate and bit errors in both directions, in
    simulated time."""

    def __init__(self, dictionary: Dictionary, golden: Golden, baud: int, faults: FaultRates) -> None:
        profile = shipped_camera("cubestar")
        memory = Memory.in_ram()
        burn_golden(memory, profile, golden)
        tracker = StarTracker(profile, SimulatedSky(profile, Inertial.pointing(1.5, 0.1, 0.3), 2026.0, SEED), memory)
        self.baud, self.now_s = baud, 100.0
        self.device = SimulatedDevice(dictionary, Identity(line_baud=baud), memory, tracker, self.now_s)
        self.host, self._hash = HostSession(dictionary), dictionary.hash
        self.events: list[SessionEvent] = []
        self._faults = LineFaults(faults, SEED), LineFaults(faults, SEED + 1)
        self._up, self._down = bytearray(), bytearray()
        self.host.link_up(self.now_s)

    def step(self) -> None:
        """Advance by one time step."""
        self.now_s += STEP_S
        step_bytes = int(self.baud / BITS_PER_BYTE * STEP_S)
        out, events = self.host.poll(self.now_s)
        self._up += out
        uplink, self._up = bytes(self._up[:step_bytes]), self._up[step_bytes:]
        self.device.advance(self.now_s)
        self.device.feed(self._faults[0].apply(uplink), self.now_s)
        while len(self._down) < step_bytes:
            frame = self.device.next_frame(self.now_s)
            if frame is None:
                break
            self._down += frame
        downlink, self._down = bytes(self._down[:step_bytes]), self._down[step_bytes:]
        self.events = events + self.host.feed(self._faults[1].apply(downlink), self.now_s)

    def wait_for_hello(self) -> None:
        """Run until the device has identified itself."""
        while self.host.hello is None and self.now_s < TIMEOUT_S:
            self.step()

    def take_image(self) -> bool:
        """Take an image into slot 0. Resend the command until the device reports completion. Return False on
        timeout."""
        request_id = self.host.submit(self.host.encode("TAKE_IMAGE", {}))
        while self.now_s < TIMEOUT_S:
            self.step()
            for event in self.events:
                if not isinstance(event, CommandUpdate) or event.request_id != request_id:
                    continue
                if event.stage is Stage.COMPLETED:
                    return True
                if event.stage is Stage.UNKNOWN:
                    self.host.retry(request_id, self.now_s)
        return False

    def download(self) -> tuple[float, TransferUpdate]:
        """Download slot 0. Return simulated seconds and the final update."""
        return self._finish(self.host.transfers.start_download("frame", 0), "verified")

    def upload(self, image: bytes) -> tuple[float, TransferUpdate]:
        """Upload a catalogue to bank B and commit it. Return simulated seconds and the final update."""
        header, hello = read_header(image), self.host.hello
        device_model = hello.device_model if hello else ""
        facts = (
            device_model,
            header.profile_name,
            self._hash,
            HEADER_VERSION,
            header.epoch_jyear,
            header.stars,
            header.pairs,
        )
        return self._finish(self.host.transfers.start_upload("catalogue", 1, image, Compatibility(*facts)), "committed")

    def _finish(self, transfer_id: int, end_state: str) -> tuple[float, TransferUpdate]:
        start_s = self.now_s
        while (
            self.host.transfer(transfer_id).state.value not in (end_state, "failed")
            and self.now_s < start_s + TIMEOUT_S
        ):
            self.step()
        return self.now_s - start_s, self.host.transfer(transfer_id)


def transfers(quick: bool) -> list[BenchTable]:
    """Return the efficiency of a frame download and a catalogue upload at several bit error rates."""
    dictionary = load_dictionary()
    golden = build_golden(shipped_camera("cubestar"), Memory.in_ram().bank_bytes)
    cases = [(baud, rate) for baud in BAUDS for rate in ERROR_RATES]
    rows: list[tuple[str, dict[str, Value]]] = []
    for baud, rate in cases[len(ERROR_RATES) : len(ERROR_RATES) + 1] if quick else cases:
        label = f"{baud:,} Bd, bit error rate {rate:g}"
        for direction in ("frame down", "catalogue up"):
            line = SimulatedLine(dictionary, golden, baud, FaultRates(bit_error_rate=rate))
            line.wait_for_hello()
            line.take_image()
            rows.append(
                (f"{label}, {direction}", _transfer(line, golden.image if direction == "catalogue up" else None))
            )
    conditions = (
        "Ground session and simulated device in one process, simulated time in steps of 10 ms, ten bits per byte; "
        "bit errors in both directions. A frame of 512 KiB is downloaded, or the factory catalogue is uploaded, read back "
        "and committed, while housekeeping is sent on the same line. Each is the first transfer of a contact. share_percent: "
        "content relative to the capacity of the line; chunk_bytes: chunk size at the end; resent: number of chunks sent again; "
        "processor_ms: processor time of both ends."
    )
    return [BenchTable("transfer", "Transfers", conditions, SEED, rows)]


def _transfer(line: SimulatedLine, image: bytes | None) -> dict[str, Value]:
    processor_ms, (line_s, update) = timed_ms(line.download if image is None else lambda: line.upload(image))
    return {
        "state": update.state.value,
        "bytes": update.size,
        "line_s": line_s,
        "share_percent": 100 * update.stored_bytes * BITS_PER_BYTE / line.baud / line_s,
        "chunk_bytes": update.chunk_size,
        "resent": update.resent,
        "processor_ms": processor_ms,
    }
