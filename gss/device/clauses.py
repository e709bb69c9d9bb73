"""Numbered clauses of the interface document: what both ends guarantee. ``gss check device`` tests them by number.

Numbers are part of the interface: a deleted clause leaves a gap, a new one takes a new number at the end of its
section.
"""

from __future__ import annotations

from dataclasses import dataclass

from gss.device.protocol.frame import MAX_PACKET_BYTES
from gss.domain.errors import NotFound


@dataclass(frozen=True)
class Clause:
    """One clause. ``unchecked``: why no program at the far end of a line can test it, "" if one can."""

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
    ("7", "Contents"),
)
NEEDS_RESET = "needs a reset in the middle of a command"
NEEDS_BREAK = "needs a broken line"
SWITCHES = "switches a unit off: only with --write"

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
    Clause(
        "4.14",
        "A command whose unit has no power is rejected (`powered_off`): images need imager, FPGA and SRAM, searches SRAM. "
        "SRAM without power forgets its images. POWER does not switch a unit on that latched up; CLEAR_LATCHUP does.",
        SWITCHES,
    ),
    Clause(
        "4.15",
        "SCHEDULE keeps a command in flash. It runs once when the device's clock reaches its time, with all the checks of a "
        "command from the ground; SCHEDULE_RUN or SCHEDULE_FAILED and all it causes carry the request id of its SCHEDULE.",
    ),
    Clause(
        "4.16",
        "SCHEDULE fails for bytes that are no command (`unknown_command`, `bad_length`, `out_of_range`), for a time that is "
        "over (`out_of_range`), and for HELLO, ABORT and SCHEDULE itself (`wrong_state`).",
    ),
    Clause(
        "4.17",
        "The schedule survives a reset. What should have run while the processor was down is missed, is not run late, and "
        "says so (SCHEDULE_FAILED); what a reset interrupts has failed (`reset`).",
        NEEDS_RESET,
    ),
    Clause("4.18", "At most 16 commands wait; one more is refused (`schedule_full`).", "would fill the schedule"),
    Clause("4.19", "CANCEL takes a waiting command back, 0 all of them; nothing with that number is `not_found`."),
    Clause("4.20", "What is marked simulator only, a real unit rejects (`unknown_command`)."),
    Clause("5.1", "Housekeeping comes unasked once in a second of the device's clock."),
    Clause("5.2", "GET_STATUS brings housekeeping at once."),
    Clause("5.3", "A telemetry packet has the layout of its table, and each value lies in the range of its kind."),
    Clause("5.4", "Housekeeping counts the commands that were accepted and those that were rejected."),
    Clause(
        "5.5", "GET_CENTROIDS, GET_MATCHES and GET_ATTITUDE send the packet made last again; before one, `no_image`."
    ),
    Clause(
        "5.6",
        "While an orbit is given and the clock is set, `matched_vectors` follows every attitude.",
        "changes what the device knows of its orbit and time",
    ),
    Clause(
        "5.7", "READ_MEMORY sends as many bytes as asked for; beyond the end of a memory it fails (`out_of_range`)."
    ),
    Clause("5.8", "LIST_TABLES tells of every table in every bank."),
    Clause(
        "5.9",
        "A latch-up raises the rail's current; the protection switches it off and says so (LATCHUP).",
        "needs radiation",
    ),
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
    Clause("6.10", "A region brings those columns and rows of the image."),
    Clause(
        "6.11",
        "Star windows bring squares of odd side, 5 to 31 pixels, round the centroids of the image, cut at its edges; where "
        "the image has not been searched, it is.",
    ),
    Clause(
        "6.12",
        "Star list and distance table of a bank are its image behind the header, in this order; a format's sections may follow "
        "(a format without distances has no table to bring: `not_found`).",
    ),
    Clause(
        "6.13",
        "Tables (triplets, calibration, parameters) travel as catalogues do, target 0 = A, 1 = B, 3 = factory; the active "
        "one and the factory's cannot be written (`bank_active`, `write_protected`).",
    ),
    Clause(
        "6.14",
        "A table becomes active only by ACTIVATE_TABLE, and stays so only after CONFIRM_TABLE in its time and before a "
        "reset. Then chain, camera or constants are those of the table; SET_DETECTION still overrules them.",
        "would change the table in use",
    ),
    Clause(
        "6.15",
        "A broken upload opened again may go on in chunks of another size: what is wholly held is kept.",
        NEEDS_BREAK,
    ),
    Clause("6.16", "A part that is not in the image, or a side that is not allowed, is refused (`out_of_range`)."),
    Clause(
        "6.17",
        "A table is verified and committed like a catalogue; what is no table, another camera's, or has values that cannot "
        "be, is refused at the commit (`incompatible`).",
        "writes flash: only with --write",
    ),
    Clause(
        "7.1", "Images are rows from top to bottom; a pixel is one byte up to eight bits, else two, high byte first."
    ),
    Clause(
        "7.2",
        "Star windows: u16 columns and u16 rows of the frame, u8 bytes per pixel, u8 number of windows; per window u16 column "
        "and u16 row of its first pixel, u8 columns, u8 rows, and its pixels as in 7.1.",
    ),
    Clause(
        "7.3",
        "Calibrations and parameter sets, little-endian: 4 bytes `GSSK` or `GSSP`, u8 version 1, u8 0, u16 64, 16 bytes camera "
        "profile, 16 bytes distortion model or chain, u16 number of values n, u16 0, u32 length of the body, 8 bytes 0, u32 "
        "CRC-32 of the body, u32 CRC-32 of the 60 bytes before. Body: n times u8 length of a name, the name in ASCII, f64 "
        "value; names ascending.",
    ),
    Clause(
        "7.4",
        "Bank images, little-endian: 64 bytes of header, the star list, the distance table. CubeStar's format: i16 id[n], f32 "
        "x[n], y[n], z[n]; i16 first[m], i16 second[m], f32 distance[m] in rad. Sunsat's: n times f32 right ascension, "
        "declination (rad), magnitude; m times u16 first, u16 second, f32 distance in rad.",
    ),
    Clause("7.5", "The memory `registers` holds the bytes of a housekeeping packet of this moment."),
    Clause(
        "7.6",
        "Body axes of `matched_vectors` are Sunsat's (Jacobs 1995 §1.3): the boresight is (1, −1, 0)/√2, higher columns are "
        "(1, 1, 0)/√2, higher rows are +z. Orbit axes: +z to nadir, +x along the velocity. Reference directions are shifted "
        "by the aberration of the Earth's and the satellite's velocity.",
        "needs a sensor whose mounting is known",
    ),
    Clause(
        "7.7",
        "Triplet tables, little-endian: 64 bytes of header with the classes, the number of stars and the CRC-32 of the bank "
        "image they belong to, then u32 key[m] ascending, u16 star[m].",
        "only some units have triplets",
    ),
)


def clause(number: str) -> Clause:
    """Return the clause of that number. Raises NotFound."""
    for one in CLAUSES:
        if one.number == number:
            return one
    raise NotFound("no such clause", expected=", ".join(c.number for c in CLAUSES), got=number)


def section_markdown(section: str) -> str:
    """Return the clauses of a section as a Markdown list."""
    mine = [c for c in CLAUSES if c.number.split(".")[0] == section]
    return "\n".join(f"- **{c.number}** {c.text}" for c in mine)
