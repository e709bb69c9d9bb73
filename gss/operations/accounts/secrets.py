"""Random keys and what is kept of them. They have 256 bits, so a plain hash is enough where a password needs a slow one."""

from __future__ import annotations

import hashlib
import secrets

BYTES = 32
LONGEST = 200
TOKEN_MARK = "gss_"  # noqa: S105 - how a token begins, so that scanners of repositories find a leaked one


def new_key() -> str:
    """A key nobody can guess, in characters that fit a cookie and an address."""
    return secrets.token_urlsafe(BYTES)


def new_token() -> str:
    """A key for a program."""
    return TOKEN_MARK + new_key()


def key_hash(key: str) -> str:
    """What is stored of a key."""
    return hashlib.sha256(key.encode("utf-8", "replace")).hexdigest()


def csrf_of(key: str) -> str:
    """What a page must send with a change: bound to the session's key, and useless for finding it."""
    return hashlib.sha256(b"gss csrf " + key.encode("utf-8", "replace")).hexdigest()


def same(given: str, expected: str) -> bool:
    """Compared in constant time."""
    return secrets.compare_digest(given.encode("utf-8", "replace"), expected.encode("utf-8", "replace"))
