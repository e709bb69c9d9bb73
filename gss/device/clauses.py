"""The numbered sentences of the interface document: what both ends promise. ``gss check device`` tests them by number.

Numbers are part of the interface: a clause that goes leaves a gap, a new one takes a new number at the end of its section.
"""

from __future__ import annotations

from dataclasses import dataclass

from gss.device.protocol.frame import MAX_PACKET_BYTES
from gss.domain.errors import NotFound


@dataclass(frozen=True)
class Clause:
    """One promise. ``unchecked``: why no program at the far end of a line can test it, "" where one can."""

    number: str
    text: str
    unchecked: str = ""


SECTIONS: tuple[tuple[str, str], ...] = (
    ("1", "Line"),
    ("2", "Packet"),
    ("3", "Identity"),
    ("4", "Command life"),
    ("5", "Telemetry"),
    ("6", "Transfers"),
)
NEEDS_RESET = "needs a reset in the middle of a command"
NEEDS_BREAK = "needs a broken line"

CLAUSES: tuple[Clause, ...] = (
    Clause(
        "1.1",
        "The line is asynchronous serial with 8 data bits, no parity and 1 stop bit, or one TCP connection that carries "
        "the same bytes.",
        "whoever reads this has a line that works",
    ),
    Clause("1.2", "A frame is `00`, COBS(packet), `00`. Empty frames mean nothing."),
    Clause("1.3", f"Packets are at most {MAX_PACKET_BYTES} bytes; longer frames are dropped and counted."),
    Clause("1.4", "Bytes before the first `00` after opening are dropped and counted.", "needs the port opened anew"),
    Clause("1.5", "A packet with a wrong CRC-32 is dropped without an answer, and counted."),
    Clause("2.1", "All numbers are big-endian; the headers are those of the table."),
    Clause("2.2", "The sequence count of each packet type rises by one from packet to packet, modulo 2¹⁴."),
    Clause("2.3", "Every packet carries the first two bytes of its sender's dictionary hash."),
    Clause("2.4", "What a command causes carries its request id; what is sent unasked carries 0."),
    Clause("3.1", "HELLO is answered to any dictionary, with all its values."),
    Clause("3.2", "HELLO tells the SHA-256 of the dictionary that the device speaks."),
    Clause("3.3", "HELLO tells the highest request id that the device has seen; the ground goes on above it."),
    Clause(
        "4.1",
        "A report answers each stage: accepted or rejected, started, progress, completed or failed; a completed report "
        "ends with the command's returned values.",
    ),
    Clause("4.2", "Acceptance and completion are reported within the times of the command's row."),
    Clause("4.3", "An argument is accepted at both ends of its range."),
    Clause("4.4", "An argument outside its range is rejected (`out_of_range`)."),
    Clause("4.5", "A code that no command has is rejected (`unknown_command`)."),
    Clause("4.6", "Arguments of the wrong length are rejected (`bad_length`)."),
    Clause(
        "4.7",
        "A command from another dictionary is rejected (`wrong_dictionary`) unless its row says that any dictionary will do.",
    ),
    Clause("4.8", "A command whose condition does not hold is rejected (`wrong_state`)."),
    Clause(
        "4.9",
        "The same request id with the same content gets the last report again, marked `replayed`, and is not carried "
        "out again. HELLO and ABORT are carried out each time.",
    ),
    Clause("4.10", "The same request id with other content is rejected (`id_reused`)."),
    Clause("4.11", "The device keeps the last 64 ids with their last report, over resets too.", NEEDS_RESET),
    Clause("4.12", "What ran during a reset has failed (`reset`).", NEEDS_RESET),
    Clause("4.13", "ABORT stops the cycle, the running command (failed, `aborted`) and every transfer."),
    Clause("5.1", "Housekeeping comes unasked once in a second of the device's clock."),
    Clause("5.2", "GET_STATUS brings housekeeping at once."),
    Clause("5.3", "A telemetry packet has the layout of its table, and each value lies in the range of its kind."),
    Clause("5.4", "Housekeeping counts the commands that were accepted and those that were rejected."),
    Clause(
        "6.1",
        "The ground opens; the device answers OPENED with a session number, a window and the chunk size, or refuses with "
        "ABORT_TRANSFER (session 0).",
    ),
    Clause(
        "6.2",
        "The sender keeps at most a window of chunks on their way. The receiver sends STATUS after a quarter of a window, "
        "when complete, and when asked.",
        "what is on the way cannot be seen from one end",
    ),
    Clause(
        "6.3",
        "A chunk that is not stored although its serial is not above the STATUS's is lost and is sent again.",
        "needs a line that loses chunks",
    ),
    Clause(
        "6.4",
        "After a break the same content opened again resumes: OPENED says `resumed`, and the sender learns what is held "
        "from STATUS pages before it sends.",
        NEEDS_BREAK,
    ),
    Clause("6.5", "A download brings the content whose SHA-256 OPENED tells, and ends with CLOSE."),
    Clause(
        "6.6",
        "An upload into the active bank or a write-protected one is refused (`bank_active`, `write_protected`).",
    ),
    Clause(
        "6.7",
        "An upload ends with VERIFY (read-back from flash), VERIFIED, COMMIT, COMMITTED; then the bank holds what was sent.",
        "writes flash: only with --write",
    ),
    Clause("6.8", "A session that stays silent for 15 s is suspended.", NEEDS_BREAK),
    Clause(
        "6.9",
        "Banks become active only by ACTIVATE_BANK, and stay so only after CONFIRM_BANK.",
        "would change the catalogue in use",
    ),
)


def clause(number: str) -> Clause:
    """The clause of that number; NotFound otherwise."""
    for one in CLAUSES:
        if one.number == number:
            return one
    raise NotFound("no such clause", expected=", ".join(c.number for c in CLAUSES), got=number)


def section_markdown(section: str) -> str:
    """The clauses of a section as a list."""
    mine = [c for c in CLAUSES if c.number.split(".")[0] == section]
    return "\n".join(f"- **{c.number}** {c.text}" for c in mine)
