"""Random keys and their stored hashes. Keys have 256 bits, so a fast hash is sufficient; passwords need a slow hash."""

from __future__ import annotations

import hashlib
import secrets

BYTES = 32
LONGEST = 200
TOKEN_MARK = "gss_"  # noqa: S105 - prefix of a token, with which repository scanners find leaked tokens


def new_key() -> str:
    """Return a random key of characters that are valid in cookies and URLs."""
    return secrets.token_urlsafe(BYTES)


def new_token() -> str:
    """Return a random API token."""
    return TOKEN_MARK + new_key()


def key_hash(key: str) -> str:
    """Return the hash of a key for storage."""
    return hashlib.sha256(key.encode("utf-8", "replace")).hexdigest()


def csrf_of(key: str) -> str:
    """Return the CSRF token of a session. It is derived from the session key, which cannot be computed from it."""
    return hashlib.sha256(b"gss csrf " + key.encode("utf-8", "replace")).hexdigest()


def same(received: str, expected: str) -> bool:
    """True if two secrets are equal. The comparison takes constant time."""
    return secrets.compare_digest(received.encode("utf-8", "replace"), expected.encode("utf-8", "replace"))
