"""Conformance checks of downloads and queries: parts of images, sections of a bank, tables, memory areas, and repeated
results."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from gss.catalogue_tools.onboard import HEADER_BYTES, SECTIONS_VERSION, read_header
from gss.device.protocol.codec import Decoded, decode
from gss.device.protocol.packet import Packet
from gss.device.protocol.windows import decode_windows
from gss.device.session_events import TransferUpdate
from gss.device.session_transfer import Part
from gss.device.tables import BAD_PIXELS
from gss.domain.errors import CorruptData
from gss.instruments.dictionary.definitions import Value
from gss.operations.checks.check_findings import Findings, shown
from gss.operations.checks.probe import Probe
from gss.operations.transfers.flash_banks import CATALOGUES
from gss.operations.transfers.table_content import read_back

SIDE_PX = 9
PIECE_BYTES = 240
RESULTS = (("GET_CENTROIDS", "FIND_CENTROIDS", "centroids"), ("GET_MATCHES", "MATCH_STARS", "matches"))


def _silent(_: TransferUpdate) -> None:
    """Ignore a progress report."""


def check_parts(probe: Probe, findings: Findings) -> None:
    """Check clauses 6.10, 6.11, 6.16, 7.1 and 7.2: regions and star windows of a new image, and rejected requests."""
    probe.order("TAKE_IMAGE", {"slot": 0})
    hello = probe.device.hello
    columns, rows = min(40, hello.columns), min(20, hello.rows)
    pixel_bytes = 1 if hello.bits <= 8 else 2
    with findings.trying("6.10", "region"):
        strip = probe.device.download("region", 0, _silent, Part(0, 0, hello.columns, rows)).data
        piece = probe.device.download("region", 0, _silent, Part(3, 2, columns - 3, rows - 2)).data
        findings.check("7.1", "region: bytes", len(strip) == hello.columns * rows * pixel_bytes, f"{len(strip)} B")
        kind = np.dtype(np.uint8) if pixel_bytes == 1 else np.dtype(">u2")
        strip_pixels = np.frombuffer(strip, kind).reshape(rows, hello.columns)
        inside = np.array_equal(np.frombuffer(piece, kind).reshape(rows - 2, columns - 3), strip_pixels[2:, 3:columns])
        findings.check("6.10", "region: the same pixels as in a larger region", inside)
    with findings.trying("6.11", "star windows"):
        done = probe.device.download("star_windows", 0, _silent, Part(columns=SIDE_PX))
        pixels, windows = decode_windows(done.data)
        shape = (hello.rows, hello.columns)
        findings.check("7.2", "star windows: frame", pixels.shape == shape, f"{pixels.shape}")
        answer = probe.order("GET_CENTROIDS")
        reported = probe.telemetry(answer.packets, "centroids")
        stars = reported[-1].lists["items"] if reported else ()
        findings.check("6.11", "star windows: one per centroid", len(windows) == len(stars), f"{len(windows)}")
        for window in windows[:1]:
            part = Part(window.col_px, window.row_px, window.columns, window.rows)
            piece = probe.device.download("region", 0, _silent, part).data
            cut = pixels[window.row_px : window.row_px + window.rows, window.col_px : window.col_px + window.columns]
            same = cut.astype(np.uint8 if pixel_bytes == 1 else ">u2").tobytes() == piece
            findings.check("6.11", "star windows: the pixels of the region", same)
    cases: tuple[tuple[str, dict[str, Value]], ...] = (
        ("a region of zero pixels", {"kind": "region", "columns": 0, "rows": 0}),
        ("a region beyond the edge", {"kind": "region", "columns": hello.columns, "rows": 1, "col_px": 1}),
        ("windows with an even side", {"kind": "star_windows", "columns": SIDE_PX + 1}),
        ("windows too large", {"kind": "star_windows", "columns": 33}),
    )
    for subject, values in cases:
        _check_refused(probe, findings, subject, values)


def _check_refused(probe: Probe, findings: Findings, subject: str, values: Mapping[str, Value]) -> None:
    plain: dict[str, Value] = {"target": 0, "chunk_bytes": 256, "held_sha256": bytes(32), "rows": 0}
    plain |= {"col_px": 0, "row_px": 0, "columns": 0}
    name, reply = probe.transfer_reply(probe.transfer("OPEN_DOWNLOAD", plain | dict(values)))
    refused = name == "ABORT_TRANSFER" and reply["reason"] == "out_of_range"
    findings.check("6.16", subject, refused, f"{name or 'no answer'} {shown(reply.get('reason', ''))}")


def check_sections(probe: Probe, findings: Findings) -> None:
    """Check clauses 6.12 and 7.4: the active bank's image begins with header, star list and distance table. Other sections can
    follow, depending on the format."""
    active = next(b for b in probe.banks() if b["active"])
    number = CATALOGUES.number(probe.operations, str(active["bank"]))
    with findings.trying("6.12", "sections"):
        image = probe.device.download("catalogue", number, _silent).data
        kinds = ("star_list", "distance_table") if int(active["pairs"]) else ("star_list",)
        parts = [probe.device.download(kind, number, _silent).data for kind in kinds]
        body, joined = image[HEADER_BYTES:], b"".join(parts)
        consistent = body.startswith(joined) and (
            len(body) == len(joined) or read_header(image).version == SECTIONS_VERSION
        )
        findings.check("6.12", "sections: in sequence, they equal the image", consistent)
        counts = tuple(map(len, parts))
        rows = zip(counts, (int(active["stars"]), int(active["pairs"])), strict=False)
        fits = all(size % max(1, count) == 0 for size, count in rows)
        findings.check("7.4", "sections: rows of equal length", fits, " and ".join(f"{size} B" for size in counts))


def tables(probe: Probe) -> list[Mapping[str, Value]]:
    """Return the rows reported by LIST_TABLES."""
    answer = probe.order("LIST_TABLES")
    return [t.values for t in probe.telemetry(answer.packets, "table_info")]


def table_number(probe: Probe, bank: str) -> int:
    """Return the number of a table's bank in the protocol."""
    return probe.dictionary.command("VERIFY_TABLE").argument("bank").choice(bank).value


def check_tables(probe: Probe, findings: Findings) -> None:
    """Check clauses 5.8, 6.13 and 7.3: the table list, the active content as bytes, and write protection."""
    reported = tables(probe)
    names = {(str(t["table"]), str(t["bank"])) for t in reported}
    argument = probe.dictionary.command("VERIFY_TABLE").argument
    expected = {(t.name, b.name) for t in argument("table").choices for b in argument("bank").choices}
    findings.check("5.8", "LIST_TABLES: all", names == expected and len(reported) == len(expected), f"{len(reported)}")
    for info in reported:
        table, bank = str(info["table"]), str(info["bank"])
        if info["active"] and info["state"] == "committed" and table != "triplets":
            with findings.trying("7.3", table):
                data = probe.device.download(table, table_number(probe, bank), _silent).data
                name, _, values = read_back(table, data)
                matches_profile = name == probe.device.hello.profile and (table == BAD_PIXELS or len(values) > 1)
                findings.check("7.3", f"{table} {bank}", matches_profile, f"{len(values)} values for {name}")
        if info["active"] or bank == "factory":
            _check_protected(probe, findings, info)


def _check_protected(probe: Probe, findings: Findings, info: Mapping[str, Value]) -> None:
    """Check that the device rejects an upload to a protected bank. The bank's current content is offered, so a device that
    wrongly accepts the upload loses no data."""
    hello, table, bank = probe.device.hello, str(info["table"]), str(info["bank"])
    if not info["size_bytes"]:
        return
    values: dict[str, Value] = {name: info[name] for name in ("size_bytes", "sha256", "profile", "format_version")}
    values |= {"kind": table, "target": table_number(probe, bank), "chunk_bytes": 256}
    values |= {"device_model": hello.device_model, "dictionary_hash": probe.dictionary.hash}
    values |= {"epoch_jyear": 0.0, "stars": 0, "pairs": 0}
    request_id = probe.transfer("OPEN_UPLOAD", values)
    name, reply = probe.transfer_reply(request_id)
    refused = name == "ABORT_TRANSFER" and reply["reason"] in ("bank_active", "write_protected")
    findings.check("6.13", f"{table} {bank}", refused, f"{name or 'no answer'} {shown(reply.get('reason', ''))}")
    if name == "OPENED":
        give_up: dict[str, Value] = {"session": reply["session"], "reason": "aborted", "detail": ""}
        probe.transfer("ABORT_TRANSFER", give_up, request_id)


def check_results(probe: Probe, findings: Findings) -> None:
    """Check clauses 5.5, 5.7 and 7.5: results that are requested again, and the registers, which contain a housekeeping
    packet."""
    probe.order("TAKE_IMAGE", {"slot": 0})
    for query, measurement, packet in RESULTS:
        measured, requested = (_last(probe, probe.order(name).packets, packet) for name in (measurement, query))
        if measured is None:
            findings.skip("5.5", query, f"{measurement} returned no {packet} packet")
            continue
        same = requested is not None and (measured.values, measured.lists) == (requested.values, requested.lists)
        findings.check("5.5", query, same, "" if same else "a different packet, or none")
    with findings.trying("5.7", "READ_MEMORY"):
        fields = probe.dictionary.packet("housekeeping").fields
        status = probe.order("GET_STATUS")
        code = probe.dictionary.packet("housekeeping").code
        reported = [p for p in status.packets if p.code == code and p.request_id == status.request_id]
        if not reported:
            raise CorruptData("GET_STATUS returned no housekeeping packet with its id", got=status.text)
        size = len(reported[-1].payload)
        pieces = [(at, min(PIECE_BYTES, size - at)) for at in range(0, size, PIECE_BYTES)]
        parts = [_memory(probe, "registers", at, length) for at, length in pieces]
        fits = [len(c) for c in parts] == [length for _, length in pieces]
        findings.check("5.7", "registers: number of bytes as requested", fits, f"{sum(map(len, parts))} B")
        values = decode(fields, b"".join(parts)).values
        findings.check("7.5", "registers: a housekeeping packet", "mode" in values, f"{size} B")
        beyond = probe.order("READ_MEMORY", {"area": "registers", "address": size, "length": 1})
        findings.check("5.7", "beyond the end", beyond.is_("failed", "out_of_range"), beyond.text)


def _last(probe: Probe, packets: tuple[Packet, ...], name: str) -> Decoded | None:
    received = probe.telemetry(packets, name)
    return received[-1] if received else None


def _memory(probe: Probe, area: str, address: int, length: int) -> bytes:
    answer = probe.order("READ_MEMORY", {"area": area, "address": address, "length": length})
    received = _last(probe, answer.packets, "memory")
    if received is None:
        raise CorruptData("READ_MEMORY returned no memory packet", got=answer.text)
    return bytes(int(row["byte"]) for row in received.lists["items"])
