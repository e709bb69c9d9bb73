"""Files of link authentication: the two key slots, and the packet counter, which must never repeat."""

from __future__ import annotations

import json
import os
import secrets
import stat
from collections.abc import Callable
from pathlib import Path

from gss.device.protocol.authentication import KEY_BYTES, SLOTS, LinkKeys, PacketSigner
from gss.domain.errors import BadInput

RESERVE_US = 10_000_000
"""Number of counters that one write to the file reserves: one per microsecond for ten seconds."""


def read_link_keys(path: Path) -> LinkKeys:
    """Return the keys of a file ``{"active": 0, "keys": {"0": "<64 hex digits>"}}``.

    Raises BadInput if the file cannot be read, is readable by other users, or contains no valid keys.
    """
    try:
        mode = path.stat().st_mode
        text = path.read_text("utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise BadInput(f"cannot read the link keys in {path}", got=str(error)) from None
    if mode & (stat.S_IRWXG | stat.S_IRWXO):
        raise BadInput(f"other users can read {path}", expected="mode 600", hint=f"chmod 600 {path}")
    try:
        raw = json.loads(text)
        keys = {int(slot): bytes.fromhex(key) for slot, key in raw["keys"].items()}
        return LinkKeys(keys, int(raw["active"]))
    except (ValueError, KeyError, TypeError, AttributeError):
        raise BadInput(
            f"{path} is not a valid key file",
            expected='{"active": 0, "keys": {"0": "<64 hex digits>"}}',
            hint="create one with gss link-keys",
        ) from None


def write_link_keys(path: Path, keys: LinkKeys) -> None:
    """Write a key file that only its owner can read. An existing file is replaced atomically."""
    text = json.dumps({"active": keys.active, "keys": {str(s): k.hex() for s, k in sorted(keys.keys.items())}})
    _write_private(path, text + "\n")


def new_link_keys() -> LinkKeys:
    """Generate keys: a random key in slot 0."""
    return LinkKeys({SLOTS[0]: secrets.token_bytes(KEY_BYTES)}, SLOTS[0])


def with_new_key(keys: LinkKeys) -> LinkKeys:
    """Return the keys with a new random key in the inactive slot. The active slot does not change."""
    inactive = next(slot for slot in SLOTS if slot != keys.active)
    return LinkKeys({keys.active: keys.keys[keys.active], inactive: secrets.token_bytes(KEY_BYTES)}, keys.active)


def _write_private(path: Path, text: str) -> None:
    part = path.with_name(path.name + ".part")
    descriptor = os.open(part, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600)
    with os.fdopen(descriptor, "w", encoding="utf-8") as file:
        file.write(text)
        file.flush()
        os.fsync(file.fileno())
    part.replace(path)


def packet_signer(keys: Path, utc_us: Callable[[], int]) -> PacketSigner:
    """Return the signer for a key file; its packet counter is stored in the same folder, in ``<name>.counter``. Raises
    BadInput."""
    return PacketSigner(read_link_keys(keys), PacketCounter(keys.with_name(keys.name + ".counter"), utc_us))


class PacketCounter:
    """Counter of signed packets: UTC in microseconds. Each value is higher than the previous one, even if the clock was
    set back.

    ``path``: file with a value higher than all used counters; the file is written before the counters are used.
    ``utc_us``: returns UTC in microseconds.
    """

    def __init__(self, path: Path, utc_us: Callable[[], int]) -> None:
        self._path, self._utc_us = path, utc_us
        try:
            self._last = self._reserved = int(path.read_text("ascii"))
        except FileNotFoundError:
            self._last = self._reserved = 0
        except (OSError, ValueError) as error:
            raise BadInput(f"cannot read the packet counter in {path}", got=str(error)) from None

    def __call__(self) -> int:
        """Return the next counter. Raises OSError if it is not reserved and the file cannot be written."""
        self._last = max(self._last + 1, self._utc_us())
        if self._last >= self._reserved:
            reserved = self._last + RESERVE_US
            _write_private(self._path, str(reserved))
            self._reserved = reserved  # only now, because a counter that is not in the file could be used again
        return self._last
