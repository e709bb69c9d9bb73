"""The tree contains no secret: no private key, token of a known service, password or unexplained random string."""

from __future__ import annotations

import math
import re
import subprocess
from collections import Counter
from pathlib import Path

import pytest

KNOWN_SHAPES = {
    "a private key": r"-----BEGIN [A-Z ]*PRIVATE KEY-----\s+[A-Za-z0-9+/]{40}",
    "a cloud access key": r"\b(?:AKIA|ASIA)[0-9A-Z]{16}\b",
    "a GitHub token": r"\bgh[pousr]_[A-Za-z0-9]{36}\b",
    "a Slack token": r"\bxox[abpr]-[A-Za-z0-9-]{10,}",
    "a web token": r"\beyJ[A-Za-z0-9_-]{10,}\.eyJ[A-Za-z0-9_-]{10,}\.",
    "a key of our own": r"\bgss_[A-Za-z0-9_-]{40,}\b",
    "a password in an address": r"\b(?:https?|postgresql(?:\+\w+)?|tcp|s3)://[^\s/:@<{]+:(?!password@|hunter2@)[^\s/@<{]{3,}@",
    "a password hash": r"\$argon2id\$v=\d+\$m=\d+,t=\d+,p=\d+\$[A-Za-z0-9+/]{16,}",
}
# Generated files that contain random-looking text, such as package hashes.
GENERATED = ("constraints.txt", "constraints-dev.txt", "web/package-lock.json", "docs/icd.md")
FOLDERS_OF_DATA = ("tests/golden/", "tests/fuzz/corpus/")
ASSIGNED = re.compile(
    r"""(?i)(?:secret|token|passw(?:or)?d|api_?key|credential)s?["']?\s*[:=]\s*["']([^"'\s]{16,})["']"""
)
LONG = re.compile(r"\b[A-Za-z0-9+/_=-]{40,}\b")
RANDOM_BITS = 4.5
ALLOWED = {"correct horse battery staple"}


@pytest.fixture(scope="module")
def texts(root: Path) -> dict[str, str]:
    """Text files that git tracks or would add, by name."""
    listed = ["git", "ls-files", "--cached", "--others", "--exclude-standard"]
    names = subprocess.run(listed, cwd=root, capture_output=True, text=True).stdout.splitlines()
    contents = {}
    for name in names or [str(p.relative_to(root)) for p in root.rglob("*.py") if ".venv" not in p.parts]:
        data = (root / name).read_bytes() if (root / name).is_file() else b"\0"
        if b"\0" not in data[:8192] and not name.startswith(FOLDERS_OF_DATA):
            contents[name] = data.decode("utf-8", "replace")
    return contents


def bits_per_character(word: str) -> float:
    """Return Shannon's entropy of the word's letters.

    Random base64 of 40 letters or more has above 4.5; names and paths have less.
    """
    counts = Counter(word).values()
    return -sum(n / len(word) * math.log2(n / len(word)) for n in counts)


def test_no_file_holds_a_key_of_a_known_shape(texts: dict[str, str]) -> None:
    """No file contains a private key, a token or a password in an address."""
    assert len(texts) > 500
    for name, text in texts.items():
        for kind, shape in KNOWN_SHAPES.items():
            match = re.search(shape, text)
            assert not match, f"{name} holds {kind}: {match[0][:20]}…"


def test_no_secret_is_assigned_a_literal(texts: dict[str, str]) -> None:
    """No long random literal is assigned to a name such as ``password``."""
    for name, text in texts.items():
        for value in ASSIGNED.findall(text):
            assert value in ALLOWED or bits_per_character(value) < 3.8, f"{name}: {value[:8]}…"


def test_no_long_random_word_is_unaccounted_for(texts: dict[str, str]) -> None:
    """Every long random-looking word is in a generated file or is hexadecimal (a hash of content)."""
    for name, text in texts.items():
        if name in GENERATED:
            continue
        for word in LONG.findall(text):
            assert re.fullmatch(r"[0-9a-fA-F]+", word) or bits_per_character(word) < RANDOM_BITS, (
                f"{name}: {word[:12]}…"
            )


def test_the_scan_finds_what_it_looks_for() -> None:
    """The scan detects planted secrets."""
    private_key = "-----BEGIN RSA " + "PRIVATE KEY-----\n" + "MIIEpAIBAAKCAQEA7bq0z1Jb2m" + "QfYd9sVhTgXk3WlNnRr5uP"
    assert re.search(KNOWN_SHAPES["a private key"], private_key)
    assert re.search(KNOWN_SHAPES["a password in an address"], "postgresql+psycopg://gss:" + "q8Zr2mXv@db/gss")
    assert ASSIGNED.search("pass" + 'word = "q8Zr2mXv7LkP0sWn4TbY"')
    assert bits_per_character("q8Zr2mXv7LkP0sWn4TbY" + "c5JdG9hFe3AuRi6oV1tK") > RANDOM_BITS
