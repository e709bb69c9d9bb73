"""Numbered clauses of the interface document: the guarantees of both ends. ``gss check device`` tests them by number.

The numbers are part of the interface. Do not reuse the number of a deleted clause; add a new clause at the end of its
section.
"""

from __future__ import annotations

from dataclasses import dataclass

from gss.device.protocol.framing import MAX_PACKET_BYTES
from gss.domain.errors import NotFound


@dataclass(frozen=True)
class Clause:
    """One clause. ``unchecked``: reason why the clause cannot be tested over the line, "" if it can."""

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
MEANING = "defines the meaning of values that other clauses check"
SWITCHES = "switches a unit off: only with --write"

CLAUSES: tuple[Clause, ...] = (
    Clause(
        "1.1",
        "The line is asynchronous serial with 8 data bits, no parity and 1 stop bit, or one TCP connection that "
        "carries the same bytes.",
        "a working line is a precondition of every check",
    ),
    Clause("1.2", "A frame is `00`, COBS(packet), `00`. Empty frames are ignored."),
    Clause("1.3", f"Packets are at most {MAX_PACKET_BYTES} bytes; longer frames are dropped and counted."),
    Clause(
        "1.4", "Bytes before the first `00` after opening are dropped and counted.", "needs the port to be reopened"
    ),
    Clause("1.5", "A packet with a wrong CRC-32 is dropped without a report, and counted."),
    Clause(
        "1.6",
        "A unit uses SLIP (RFC 1055) instead of COBS if its package states this: a frame is `C0`, the packet, `C0`; "
        "inside the packet `C0` is sent as `DB DC` and `DB` as `DB DD`.",
        "would need a line with another framing",
    ),
    Clause("2.1", "All numbers are big-endian; the headers are those of the table."),
    Clause("2.2", "The sequence count of each packet type increments by one per packet, modulo 2¹⁴."),
    Clause("2.3", "Every packet carries the first two bytes of its sender's dictionary hash."),
    Clause("2.4", "Packets caused by a command carry its request id; unsolicited packets carry 0."),
    Clause(
        "2.5",
        "On a line with authentication a packet to the device has APID 0x180 + packet type and, before its CRC, a "
        "trailer: u8 key slot (0 or 1), u64 counter, and the first 16 bytes of the HMAC-SHA-256 of all bytes before "
        "them. A device with keys drops and counts every other packet, and every packet whose counter is not higher "
        "than all counters accepted before, also across resets.",
        "needs keys",
    ),
    Clause(
        "2.6",
        "The ground chooses request ids from 1 to 2³² − 1, each higher than all earlier ids. Commands and transfer "
        "openings share one sequence of ids. Every message of a transfer, in both directions, carries the id of its "
        "OPEN.",
        "a rule for the ground",
    ),
    Clause(
        "2.7",
        "The sequence count of a packet type starts at 0 when its sender starts. The device time counts seconds of the "
        "device's clock, which continues across resets; SET_TIME sets only its relation to UTC.",
        MEANING,
    ),
    Clause("3.1", "The device answers HELLO from any dictionary, and returns all values of HELLO."),
    Clause("3.2", "HELLO reports the SHA-256 of the device's dictionary."),
    Clause("3.3", "HELLO reports the highest request id that the device has received; the ground continues above it."),
    Clause(
        "3.4",
        "After opening the line and after each BOOT the ground sends HELLO, every 3 s until it is answered. A device "
        "ignores all bytes while it boots.",
        "a rule for the ground",
    ),
    Clause(
        "4.1",
        "The device reports each stage of a command: accepted or rejected, started, progress, completed or failed; a "
        "completed report ends with the command's returned values.",
    ),
    Clause("4.2", "Acceptance and completion are reported within the times stated for the command."),
    Clause("4.3", "An argument is accepted at both ends of its range."),
    Clause("4.4", "An argument outside its range is rejected (`out_of_range`)."),
    Clause("4.5", "A command code that the dictionary does not define is rejected (`unknown_command`)."),
    Clause("4.6", "Arguments of the wrong length are rejected (`bad_length`)."),
    Clause(
        "4.7",
        "A command from another dictionary is rejected (`wrong_dictionary`) unless the command permits any dictionary.",
    ),
    Clause("4.8", "A command whose precondition does not hold is rejected (`wrong_state`)."),
    Clause(
        "4.9",
        "A repeated request id with the same content returns the last report, marked `replayed`, and is not executed "
        "again. HELLO and ABORT are executed each time.",
    ),
    Clause("4.10", "A repeated request id with different content is rejected (`id_reused`)."),
    Clause("4.11", "The device keeps the 64 highest ids with their last report, also across resets.", NEEDS_RESET),
    Clause("4.12", "A command that was running at a reset fails (`reset`).", NEEDS_RESET),
    Clause("4.13", "ABORT stops the cycle, the running command (failed, `aborted`) and every transfer."),
    Clause(
        "4.14",
        "A command whose unit has no power is rejected (`powered_off`): images need imager, FPGA and SRAM; star "
        "detection needs SRAM. SRAM without power loses its images. A unit that latched up is switched on by "
        "CLEAR_LATCHUP, not by POWER.",
        SWITCHES,
    ),
    Clause(
        "4.15",
        "SCHEDULE stores a command in flash. It runs once when the device's clock reaches its time, with all the "
        "checks of a command from the ground. SCHEDULE_RUN or SCHEDULE_FAILED, and all packets that the command "
        "causes, carry the request id of its SCHEDULE.",
    ),
    Clause(
        "4.16",
        "SCHEDULE fails for bytes that are not a valid command (`unknown_command`, `bad_length`, `out_of_range`), for "
        "a time in the past (`out_of_range`), and for HELLO, ABORT and SCHEDULE itself (`wrong_state`).",
    ),
    Clause(
        "4.17",
        "The schedule survives a reset. A command whose time passed while the processor was not running is missed: it "
        "is not run late, and SCHEDULE_FAILED reports it. A command that a reset interrupts fails (`reset`).",
        NEEDS_RESET,
    ),
    Clause(
        "4.18",
        "At most 16 commands wait; any further SCHEDULE is rejected (`schedule_full`).",
        "would fill the schedule",
    ),
    Clause(
        "4.19",
        "CANCEL removes a waiting command, or all of them if the number is 0. An unknown number is rejected "
        "(`not_found`).",
    ),
    Clause("4.20", "A real unit rejects commands marked simulator only (`unknown_command`)."),
    Clause(
        "4.21",
        "A request id that is not above the highest id that the device no longer remembers is rejected (`id_reused`), "
        "and so is request id 0. HELLO and ABORT are exempt.",
    ),
    Clause(
        "4.22",
        "Commands run one at a time in order of arrival. While one runs, at most 4 wait; any further command is "
        "rejected (`busy`). ABORT runs immediately. Transfers run in parallel with commands.",
        "needs commands of long duration",
    ),
    Clause(
        "4.23",
        "The time to acceptance counts from the last byte of the command; the time to completion starts again at each "
        "report (accepted, started, progress). The ground sends the next command when the previous one has ended or "
        "timed out.",
        "a rule for the ground",
    ),
    Clause("5.1", "The device sends housekeeping unsolicited once per second of its clock."),
    Clause("5.2", "GET_STATUS sends housekeeping immediately."),
    Clause(
        "5.3",
        "A telemetry packet has the layout of its table, and each value lies in the range of its type. Boresight and "
        "roll agree with the quaternion in the same packet.",
    ),
    Clause("5.4", "Housekeeping counts accepted commands and rejected commands."),
    Clause(
        "5.5",
        "GET_CENTROIDS, GET_MATCHES and GET_ATTITUDE send the latest packet again; before the first packet they fail "
        "(`no_image`).",
    ),
    Clause(
        "5.6",
        "While an orbit and the clock are set, `matched_vectors` follows every attitude. Without an attitude, or at "
        "the end of a period without a result, it has no vectors.",
        "changes the orbit and time stored in the device",
    ),
    Clause(
        "5.7", "READ_MEMORY sends the requested number of bytes; beyond the end of a memory it fails (`out_of_range`)."
    ),
    Clause("5.8", "LIST_TABLES reports every table in every bank."),
    Clause(
        "5.9",
        "A latch-up raises the rail's current; the protection switches it off and reports LATCHUP.",
        "needs radiation",
    ),
    Clause(
        "5.10",
        "An iteration sets the mode of the next iteration and reports a change as MODE_CHANGED. With an attitude the "
        "mode becomes tracking. Without an attitude it becomes assisted after tracking (Oersted: lost_in_space), "
        "otherwise lost_in_space. Standby does not change.",
        "depends on the observed stars",
    ),
    Clause(
        "5.11",
        "The quaternion (x, y, z, w; w is the scalar) rotates directions from ICRS to camera axes: v_cam = R(q) "
        "v_icrs. Camera axes: +x to higher columns, +y to higher rows, +z out of the lens. Right ascension and "
        "declination are those of +z. Roll is the angle of celestial north from image up (−y), counter-clockwise, 0 to"
        " 360°: atan2(−n_x, −n_y) for north n in camera axes.",
        MEANING,
    ),
    Clause(
        "6.1",
        "The ground opens a transfer. The device answers OPENED with a session number, a window and the chunk size, or"
        " rejects the OPEN with ABORT_TRANSFER (session 0). It also rejects an OPEN of wrong length (`bad_length`) or "
        "with an unknown kind (`out_of_range`).",
    ),
    Clause(
        "6.2",
        "The sender keeps at most one window of chunks in transit. The receiver sends STATUS after a quarter of a "
        "window, when the transfer is complete, and on request.",
        "chunks in transit cannot be observed from one end",
    ),
    Clause(
        "6.3",
        "A chunk is lost if it is not stored and its serial is not higher than the serial in STATUS. The sender sends "
        "it again.",
        "needs a line on which chunks are lost",
    ),
    Clause(
        "6.4",
        "After an interruption, opening the same content again resumes the transfer: OPENED reports `resumed`, and the"
        " sender reads the stored chunks from STATUS pages before it sends.",
        NEEDS_BREAK,
    ),
    Clause("6.5", "A download delivers the content whose SHA-256 OPENED reports, and ends with CLOSE."),
    Clause(
        "6.6",
        "An upload into the active bank or a write-protected one is rejected (`bank_active`, `write_protected`).",
    ),
    Clause(
        "6.7",
        "An upload ends with VERIFY (read-back from flash), VERIFIED, COMMIT, COMMITTED; then the bank holds the "
        "uploaded content.",
        "writes flash: only with --write",
    ),
    Clause("6.8", "A session without packets for 15 s is suspended.", NEEDS_BREAK),
    Clause(
        "6.9",
        "Banks become active only by ACTIVATE_BANK, and stay active only after CONFIRM_BANK.",
        "would change the active catalogue",
    ),
    Clause("6.10", "A region contains the requested columns and rows of the image."),
    Clause(
        "6.11",
        "Star windows are squares of odd side, 5 to 31 pixels, around the centroids of the image, clipped at its "
        "edges. The device searches an image that has not been searched yet.",
    ),
    Clause(
        "6.12",
        "A bank image contains the header, the star list and the distance table, in this order; further sections of "
        "the format can follow. A download of the distance table is rejected if the format has none (`not_found`).",
    ),
    Clause(
        "6.13",
        "Tables (triplets, calibration, parameters, bad pixels) are transferred like catalogues, target 0 = A, 1 = B, 3 = "
        "factory. The active table and the factory tables cannot be written (`bank_active`, `write_protected`).",
    ),
    Clause(
        "6.14",
        "A table becomes active only by ACTIVATE_TABLE, and stays active only after CONFIRM_TABLE in time and before a "
        "reset. The device then uses the chain, camera, constants or bad pixels of the table; SET_DETECTION still overrides "
        "the constants.",
        "would change the active table",
    ),
    Clause(
        "6.15",
        "An interrupted upload can resume with another chunk size. The device keeps the chunks of the new size that "
        "are completely stored.",
        NEEDS_BREAK,
    ),
    Clause("6.16", "A region outside the image, or an invalid side of star windows, is rejected (`out_of_range`)."),
    Clause(
        "6.17",
        "A table is verified and committed like a catalogue. Content that is not a valid table, belongs to another "
        "camera or has impossible values is rejected at the commit (`incompatible`).",
        "writes flash: only with --write",
    ),
    Clause(
        "6.18",
        "If stars, pairs or epoch in the OPEN_UPLOAD of a catalogue are not 0, they must agree with the content; "
        "otherwise the commit is rejected (`incompatible`). An OPEN_UPLOAD with an epoch outside the years 1800 to "
        "2300 is rejected (`out_of_range`).",
        "writes flash: only with --write",
    ),
    Clause(
        "6.19",
        "A download starts with STATUS from the ground after OPENED: its pages list the stored chunks, even if there "
        "are none. The device sends no chunk before it has received the pages from chunk 0 to the last chunk; it "
        "requests a missing page with STATUS_REQUEST. A page contains at most 16 ranges.",
        MEANING,
    ),
    Clause(
        "6.20",
        "The first chunk of a session has serial 1; every chunk sent, new or repeated, has the next serial. Chunk i "
        "contains the bytes from i · chunk size on; only the last chunk may be shorter. STATUS has serial 0 before the"
        " first chunk.",
        MEANING,
    ),
    Clause(
        "6.21",
        "A message without an answer is sent again unchanged, an OPEN with the same request id, and is answered again."
        " Times of the ground: OPEN after 0.5 s times the number of tries; VERIFY and COMMIT after 1.5 s; STATUS of a "
        "receiver after 0.4 s of silence, longer at each try; STATUS_REQUEST after 0.25 s and the time of a quarter of"
        " a window, then 1.6 times longer at each try, up to 3 s. After 6 tries the transfer is interrupted and opened"
        " again after 4 s. The device sends at most 8 STATUS_REQUESTs without an answer.",
        "defines times of both ends",
    ),
    Clause(
        "6.22",
        "ABORT_TRANSFER and PAUSE end the session without an answer; chunks stored in a bank are kept for a later "
        "OPEN. After COMMIT they only close the session: the content stays committed. The event TRANSFER_ABORTED "
        "reports each ABORT_TRANSFER from the ground.",
        "writes flash: only with --write",
    ),
    Clause(
        "6.23",
        "A message for a session that is not open is answered with ABORT_TRANSFER (`no_session`), at most twice per "
        "second. A new upload to a target closes the older session. If more than 8 sessions are open, the oldest is "
        "closed.",
        MEANING,
    ),
    Clause(
        "6.24",
        "VERIFY before the last chunk is answered with STATUS. After VERIFIED with equal = 0 the session is closed and"
        " the stored content erased. COMMIT of unverified content is answered with ABORT_TRANSFER (`incomplete`).",
        "writes flash: only with --write",
    ),
    Clause(
        "6.25",
        "While a command erases a bank or table or reads it back (ERASE, VERIFY, ACTIVATE), an OPEN_UPLOAD into it is "
        "rejected (`busy`). ERASE of a bank or table with an open upload fails (`busy`).",
        "needs commands of long duration",
    ),
    Clause(
        "7.1",
        "Images are rows from top to bottom; a pixel has one byte up to eight bits, otherwise two bytes, high byte "
        "first. If the detector has dark columns, each row of a captured whole image has them in the order of the read-out; "
        "`columns` counts the light-sensitive columns only. Uploaded images, thumbnails, regions and windows have none.",
    ),
    Clause(
        "7.2",
        "Star windows: u16 columns and u16 rows of the frame, u8 bytes per pixel, u8 number of windows; per window u16"
        " column and u16 row of its first pixel, u8 columns, u8 rows, and its pixels as in 7.1.",
    ),
    Clause(
        "7.3",
        "Calibrations and parameter sets, little-endian: 4 bytes `GSSK` or `GSSP`, u8 version 1, u8 0, u16 64, 16 "
        "bytes camera profile, 16 bytes distortion model or chain, u16 number of values n, u16 0, u32 length of the "
        "body, 8 bytes 0, u32 CRC-32 of the body, u32 CRC-32 of the 60 bytes before. Body: n times u8 length of a "
        "name, the name in ASCII, f64 value; names ascending. Bad pixels: magic `GSSD`, text `median`; n times u16 column, "
        "u16 row, ascending by row, then by column. Before the detection, each is replaced by the median of the good pixels "
        "among its eight neighbours; downloaded images are not changed.",
    ),
    Clause(
        "7.4",
        "Bank images, little-endian: 64 bytes of header, the star list, the distance table. CubeStar's format: i16 "
        "id[n], f32 x[n], y[n], z[n]; i16 first[m], i16 second[m], f32 distance[m] in rad. Sunsat's: n times f32 right"
        " ascension, declination (rad), magnitude; m times u16 first, u16 second, f32 distance in rad.",
    ),
    Clause("7.5", "The memory `registers` holds the bytes of a current housekeeping packet."),
    Clause(
        "7.6",
        "Body axes of `matched_vectors` are Sunsat's (Jacobs 1995 §1.3): the boresight is (1, −1, 0)/√2, higher "
        "columns are (1, 1, 0)/√2, higher rows are +z. Orbit axes: +z to nadir, +x along the velocity. Reference "
        "directions include the aberration caused by the Earth's and the satellite's velocity.",
        "needs a sensor with a known mounting",
    ),
    Clause(
        "7.7",
        "Triplet tables, little-endian: 64 bytes of header with the classes, the number of stars and the CRC-32 of the"
        " bank image they belong to, then u32 key[m] ascending, u16 star[m].",
        "only some units use triplets",
    ),
    Clause(
        "7.8",
        "Columns and rows count from 0 at the first pixel of 7.1, which is at the top left; pixel centres are at whole "
        "numbers. Centroids, regions and star windows use these coordinates.",
        MEANING,
    ),
    Clause(
        "7.9",
        "A pixel of a thumbnail is the mean of a block of 4 × 4 pixels, rounded half to even. Incomplete blocks at the"
        " right and bottom edges are omitted. Pixels are encoded as in 7.1.",
        "the image may change between two downloads",
    ),
    Clause(
        "7.10",
        "Header of bank images: 4 bytes `GSSB`, u8 version 1 (2 where sections follow), u8 format, u16 64, u32 stars "
        "n, u32 pairs m, f64 epoch (Julian year), f32 smallest and f32 largest distance (rad), 16 bytes camera "
        "profile, 8 bytes of the SHA-256 of the profile, u32 CRC-32 of all bytes after the header, u32 CRC-32 of the "
        "60 bytes before. The formats 1 cubestar, 2 sunsat, 3 sunsat-5, 4 far-mst, 5 oersted and 6 aim are defined "
        "byte by byte in [catalogue formats](catalogue-formats.md).",
        MEANING,
    ),
    Clause(
        "7.11",
        "Header of triplet tables: 4 bytes `GSST`, u8 version 1, u8 0, u16 64, u32 stars, u32 references m, f64 width "
        "of a distance class and f64 width of an angle class (rad), f64 uncertainty of a position (rad), f32 magnitude"
        " that is detected with a probability of one half, f32 relative uncertainty of brightness, f32 largest "
        "distance (rad), u32 CRC-32 of the body of the bank image, u32 CRC-32 of the body, u32 CRC-32 of the 60 bytes "
        "before. key = first << 18 | second << 6 | angle, where all three are class numbers.",
        "only some units use triplets",
    ),
    Clause(
        "7.12",
        "Capture files of the ground, little-endian: records of f64 Unix time in s, u8 direction (0 from the device, 1"
        " to it), u32 length, and the bytes received or sent on the line. A complete "
        "file is packed with Zstandard under its name with `.zst`.",
        "defines a file of the ground",
    ),
)


def clause(number: str) -> Clause:
    """Return a clause by its number. Raises NotFound."""
    for candidate in CLAUSES:
        if candidate.number == number:
            return candidate
    raise NotFound("no such clause", expected=", ".join(c.number for c in CLAUSES), got=number)


def section_markdown(section: str) -> str:
    """Return the clauses of a section as a Markdown list."""
    clauses = [c for c in CLAUSES if c.number.split(".")[0] == section]
    return "\n".join(f"- **{c.number}** {c.text}" for c in clauses)
