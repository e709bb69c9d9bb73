"""Random keys and their stored hashes. Keys have 256 bits, so a plain hash suffices where a password needs a slow one."""

from __future__ import annotations

import hashlib
import secrets

BYTES = 32
LONGEST = 200
TOKEN_MARK = "gss_"  # noqa: S105 - how a token begins, so that scanners of repositories find a leaked one


def new_key() -> str:
    """Return an unguessable key in characters valid in cookies and URLs."""
    return secrets.token_urlsafe(BYTES)


def new_token() -> str:
    """Return a token for a program."""
    return TOKEN_MARK + new_key()


def key_hash(key: str) -> str:
    """Return the hash of a key for storage."""
    return hashlib.sha256(key.encode("utf-8", "replace")).hexdigest()


def csrf_of(key: str) -> str:
    """Return the CSRF token of a session: derived from the session's key, which cannot be recovered from it."""
    return hashlib.sha256(b"gss csrf " + key.encode("utf-8", "replace")).hexdigest()


def same(received: str, expected: str) -> bool:
    """Compare two secrets in constant time."""
    return secrets.compare_digest(received.encode("utf-8", "replace"), expected.encode("utf-8", "replace"))
