"""Objects and identifiers of the OreSat star tracker on its CAN bus, from public sources (oresat-configs, 7e7351d)."""

from __future__ import annotations

NODE = 0x2C
SDO_REQUEST, SDO_ANSWER = 0x600 + NODE, 0x580 + NODE
EMERGENCY, HEARTBEAT = 0x080 + NODE, 0x700 + NODE
HEARTBEATS = range(0x701, 0x780)
PDO = {0x180 + NODE: 1, 0x280 + NODE: 2, 0x380 + NODE: 3, 0x480 + NODE: 4, 0x181 + NODE: 5}
"""Number of each transmit PDO by identifier. Each node has identifiers for four PDOs only, so the fifth PDO uses an
identifier of the next node number."""

READ, SET = "READ_", "SET_"
STATUS, LAST_CAPTURE, PREVIEW = (0x4000, 0), (0x4001, 6), (0x4001, 5)
OBJECTS: dict[str, tuple[int, int]] = {
    "STATUS": STATUS,
    "CAPTURE_COUNT": (0x4001, 1),
    "CAPTURE_DELAY": (0x4001, 2),
    "CAPTURE_DURATION": (0x4001, 3),
    "LAST_CAPTURE": LAST_CAPTURE,
    "SAVE_CAPTURES": (0x4001, 8),
    "FILTER_ENABLE": (0x4003, 1),
    "FILTER_LOWER_BOUND": (0x4003, 2),
    "FILTER_LOWER_SHARE": (0x4003, 3),
    "FILTER_UPPER_BOUND": (0x4003, 4),
    "FILTER_UPPER_SHARE": (0x4003, 5),
    "CARD": (0x3003, 1),
    "STORAGE": (0x3003, 2),
    "MEMORY": (0x3003, 3),
    "TIME": (0x2010, 0),
}
"""Index and subindex of an object by the part of the command's name after READ_ or SET_."""


def object_of(command: str) -> tuple[tuple[int, int], bool]:
    """Return the object of a command, and True if the command writes it. Raises KeyError for an unknown command."""
    writes = command.startswith(SET)
    return OBJECTS[command.removeprefix(SET if writes else READ)], writes
