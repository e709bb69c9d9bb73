"""Conformance checks of transfers and of ABORT. Only :func:`check_writing` and :func:`check_table_writing` write to
flash, and both restore the previous content."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping

from gss.device.protocol.codec import encode
from gss.device.protocol.packet import PacketType
from gss.device.session_events import TransferUpdate
from gss.domain.errors import Conflict, CorruptData
from gss.instruments.dictionary.definitions import Value
from gss.operations.checks.check_findings import Findings, shown
from gss.operations.checks.probe import FINAL, Probe
from gss.operations.transfers.flash_banks import CATALOGUES

LONG_EXPOSURE_MS = 1000
WHOLE: Mapping[str, Value] = {"held_sha256": bytes(32), "col_px": 0, "row_px": 0, "columns": 0, "rows": 0}
THUMBNAIL: Mapping[str, Value] = {"kind": "thumbnail", "target": 0, "chunk_bytes": 256, **WHOLE}
NO_FREE_BANK = "no bank can be written: all are active, protected or unfinished"


def _silent(_: TransferUpdate) -> None:
    """Ignore a progress report."""


def _reply_text(name: str, reply: Mapping[str, Value]) -> str:
    return f"{name or 'no answer'} {shown(reply.get('reason', ''))}".strip()


def check_downloads(probe: Probe, findings: Findings) -> None:
    """Check clauses 6.1 and 6.5: a thumbnail, the active catalogue compared with its bank_info, and invalid requests."""
    exposure = probe.order("TAKE_IMAGE", {"slot": 0})
    with findings.trying("6.5", "thumbnail"):
        done = probe.device.download("thumbnail", 0, _silent)
        right = hashlib.sha256(done.data).hexdigest() == done.sha256
        findings.check("6.5", "thumbnail: hash as announced", right, f"{len(done.data)} B")
        number = exposure.last.values.get("frame_number") if exposure.last else None
        findings.check("6.5", "thumbnail: frame number", done.frame_number == number, f"{done.frame_number}")
    with findings.trying("6.5", "catalogue"):
        active = next(b for b in probe.banks() if b["active"])
        done = probe.device.download("catalogue", CATALOGUES.number(probe.operations, str(active["bank"])), _silent)
        reported = bytes(active["sha256"])  # type: ignore[arg-type]  # bytes fields decode to bytes
        right = hashlib.sha256(done.data).digest() == reported and len(done.data) == active["size_bytes"]
        findings.check("6.5", "active catalogue: hash as in bank_info", right, f"{len(done.data)} B")
    refusals: tuple[tuple[str, dict[str, Value]], ...] = (
        ("a slot that does not exist", {"kind": "frame", "target": 255, "chunk_bytes": 256}),
        ("chunks of zero bytes", {"kind": "thumbnail", "target": 0, "chunk_bytes": 0}),
    )
    for subject, values in refusals:
        request_id = probe.transfer("OPEN_DOWNLOAD", {**values, **WHOLE})
        name, reply = probe.transfer_reply(request_id)
        refused = name == "ABORT_TRANSFER" and reply["session"] == 0
        findings.check("6.1", subject, refused, _reply_text(name, reply))
    code = probe.dictionary.service("OPEN_DOWNLOAD").code
    unknown_kind = bytes([255]) + encode(probe.dictionary.service("OPEN_DOWNLOAD").fields, THUMBNAIL)[1:]
    for subject, payload, reason in (
        ("an unknown kind", unknown_kind, "out_of_range"),
        ("an empty OPEN", b"", "bad_length"),
    ):
        name, reply = probe.transfer_reply(probe.send(PacketType.TRANSFER, code, payload))
        findings.check("6.1", subject, name == "ABORT_TRANSFER" and reply["reason"] == reason, _reply_text(name, reply))
    request_id = probe.transfer("OPEN_DOWNLOAD", THUMBNAIL)
    name, reply = probe.transfer_reply(request_id)
    if findings.check("6.1", "a thumbnail", name == "OPENED", name or "no answer"):
        fits = bool(reply["session"]) and bool(reply["window_chunks"]) and 0 < int(reply["chunk_bytes"]) <= 256
        findings.check("6.1", "a thumbnail: session, window and chunk size", fits)
        probe.transfer("ABORT_TRANSFER", _give_up(reply), request_id)


def _give_up(reply: Mapping[str, Value]) -> dict[str, Value]:
    return {"session": reply["session"], "reason": "aborted", "detail": ""}


def check_upload_refusals(probe: Probe, findings: Findings) -> None:
    """Check clause 6.6. The bank's current content is offered, so a device that wrongly accepts the upload loses no data."""
    for bank in probe.banks():
        if not (bank["active"] or bank["write_protected"]) or not bank["size_bytes"]:
            continue
        request_id = probe.transfer("OPEN_UPLOAD", _offer(probe, bank))
        name, reply = probe.transfer_reply(request_id)
        refused = name == "ABORT_TRANSFER" and reply["reason"] in ("bank_active", "write_protected")
        kind = "active" if bank["active"] else "write protected"
        findings.check("6.6", f"bank {shown(bank['bank'])} ({kind})", refused, _reply_text(name, reply))
        if name == "OPENED":
            probe.transfer("ABORT_TRANSFER", _give_up(reply), request_id)


def _offer(probe: Probe, bank: Mapping[str, Value]) -> dict[str, Value]:
    """Return OPEN_UPLOAD values for an upload of a bank's current content to the same bank."""
    hello, dictionary = probe.device.hello, probe.dictionary
    same = ("size_bytes", "sha256", "profile", "format_version", "epoch_jyear", "stars", "pairs")
    return {name: bank[name] for name in same} | {
        "kind": "catalogue",
        "target": CATALOGUES.number(probe.operations, str(bank["bank"])),
        "chunk_bytes": 256,
        "device_model": hello.device_model,
        "dictionary_hash": dictionary.hash,
    }


def check_aborts(probe: Probe, findings: Findings) -> None:
    """Check clause 4.13: ABORT stops the cycle, a running command, and an open transfer."""
    probe.order("SET_MODE", {"mode": "lost_in_space"})
    probe.order("START_CYCLE")
    running = probe.status()["cycle_running"]
    probe.order("ABORT")
    stopped = running is True and probe.status()["cycle_running"] is False
    findings.check("4.13", "cycle", stopped, "" if running else "the cycle did not start")
    _check_running_command(probe, findings)
    probe.order("TAKE_IMAGE", {"slot": 0})
    request_id = probe.transfer("OPEN_DOWNLOAD", THUMBNAIL)
    name, _ = probe.transfer_reply(request_id)
    probe.send(PacketType.COMMAND, probe.dictionary.command("ABORT").code, b"")
    ended, reply = probe.transfer_reply(request_id)
    fits = name == "OPENED" and ended == "ABORT_TRANSFER" and reply["reason"] == "aborted"
    findings.check("4.13", "transfer", fits, f"{name or 'no answer'}, then {ended or 'no answer'}")


def _check_running_command(probe: Probe, findings: Findings) -> None:
    """Check that ABORT stops a long exposure."""
    command = probe.dictionary.command("TAKE_IMAGE")
    payload = probe.payload(command, {"slot": 0, "exposure_ms": LONG_EXPOSURE_MS})
    start = len(probe.tap.packets)
    request_id = probe.send(PacketType.COMMAND, command.code, payload)
    probe.order("ABORT")
    last = next((r for r in reversed(probe.reports(request_id, start)) if r.stage in FINAL), None)
    fits = last is not None and (last.stage, last.reason) == ("failed", "aborted")
    findings.check("4.13", "running command", fits, f"{last.stage} ({last.reason})" if last else "no final report")


def check_writing(probe: Probe, findings: Findings) -> None:
    """Check clause 6.7 with an inactive bank, then restore the bank's content."""
    banks = probe.banks()
    active = next(b for b in banks if b["active"])
    free = [b for b in banks if not b["active"] and not b["write_protected"] and b["state"] in ("empty", "committed")]
    if not free:
        findings.skip("6.7", "upload", NO_FREE_BANK)
        return
    free.sort(key=lambda b: b["state"] != "empty")
    bank = free[0]
    name, number = str(bank["bank"]), CATALOGUES.number(probe.operations, str(bank["bank"]))
    with findings.trying("6.7", f"bank {name}"):
        image = probe.device.download(
            "catalogue", CATALOGUES.number(probe.operations, str(active["bank"])), _silent
        ).data
        old_content = probe.device.download("catalogue", number, _silent).data if bank["state"] == "committed" else b""
        if bank["sha256"] == active["sha256"]:
            # The device would recognize the content that it already has and would not write it.
            probe.order("ERASE_BANK", {"bank": name})
        try:
            _check_upload(probe, findings, name, image)
        finally:
            _put_back(probe, findings, name, old_content)
        after = next(b for b in probe.banks() if b["bank"] == name)
        same = (after["state"], after["sha256"]) == (bank["state"], bank["sha256"])
        findings.check("6.7", f"bank {name}: previous content restored", same, shown(after["state"]))


def _check_upload(probe: Probe, findings: Findings, name: str, image: bytes) -> None:
    states: list[str] = []
    sha256 = probe.device.upload(image, name, lambda update: states.append(update.state))
    findings.check("6.7", f"bank {name}: verified and committed", "verifying" in states, f"{len(image)} B")
    answer = probe.order("VERIFY_BANK", {"bank": name})
    read = answer.last.values.get("sha256") if answer.last else None
    findings.check("6.7", f"bank {name}: VERIFY_BANK", read == bytes.fromhex(sha256), answer.text)
    reported = next(b for b in probe.banks() if b["bank"] == name)
    fits = reported["state"] == "committed" and reported["sha256"] == bytes.fromhex(sha256) and not reported["active"]
    findings.check("6.7", f"bank {name}: bank_info", fits, shown(reported["state"]))
    back = probe.device.download("catalogue", CATALOGUES.number(probe.operations, name), _silent).data
    findings.check("6.7", f"bank {name}: downloaded content is identical", back == image, f"{len(back)} B")


def _put_back(probe: Probe, findings: Findings, name: str, content: bytes) -> None:
    """Restore the bank's previous content, or erase it if it was empty."""
    try:
        if content:
            probe.device.upload(content, name, _silent)
        else:
            probe.order("ERASE_BANK", {"bank": name})
    except (Conflict, CorruptData) as error:
        findings.not_restored.append(f"the previous content of bank {name} was not restored: {error}")


def check_table_writing(probe: Probe, findings: Findings) -> None:
    """Check clause 6.17: upload the active calibration into an empty bank, read it back, and erase the bank."""
    answer = probe.order("LIST_TABLES")
    reported = [t.values for t in probe.telemetry(answer.packets, "table_info") if t.values["table"] == "calibration"]
    active = next((t for t in reported if t["active"] and t["state"] == "committed"), None)
    free = next((t for t in reported if t["state"] == "empty" and t["bank"] != "factory"), None)
    if active is None or free is None:
        findings.skip("6.17", "calibration", "no empty bank, or no active calibration")
        return
    numbers = {c.name: c.value for c in probe.dictionary.command("VERIFY_TABLE").argument("bank").choices}
    bank, version = str(free["bank"]), int(active["format_version"])
    with findings.trying("6.17", f"calibration {bank}"):
        data = probe.device.download("calibration", numbers[str(active["bank"])], _silent).data
        try:
            sha256 = probe.device.upload_table("calibration", data, numbers[bank], version, _silent)
            verified = probe.order("VERIFY_TABLE", {"table": "calibration", "bank": bank})
            read = verified.last.values.get("sha256") if verified.last else None
            findings.check("6.17", f"calibration {bank}: verified", read == bytes.fromhex(sha256), verified.text)
            back = probe.device.download("calibration", numbers[bank], _silent).data
            findings.check(
                "6.17", f"calibration {bank}: downloaded content is identical", back == data, f"{len(back)} B"
            )
            with_damage = data[:-1] + bytes([data[-1] ^ 1])
            probe.order("ERASE_TABLE", {"table": "calibration", "bank": bank})
            findings.check(
                "6.17", "a damaged table is rejected", _refused_at_commit(probe, with_damage, numbers[bank], version)
            )
        finally:
            probe.order("ERASE_TABLE", {"table": "calibration", "bank": bank})


def _refused_at_commit(probe: Probe, data: bytes, target: int, version: int) -> bool:
    try:
        probe.device.upload_table("calibration", data, target, version, _silent)
    except Conflict as error:
        return "incompatible" in error.got
    return False
