"""Detection of passwords that guessing programs try first: common words with added digits and signs, names, sequences,
repetition."""

from __future__ import annotations

import unicodedata

LONGEST = 200
"""Maximum length of a password, in characters."""
MIN_LETTERS = 5
"""Minimum number of letters that remain after common words and the user name are removed."""
MIN_DIFFERENT = 5
SEQUENCE_SHARE = 0.7
"""A password is a sequence if at least this fraction of its character pairs are neighbours on a keyboard or in the alphabet."""
SEQUENCES = (
    "abcdefghijklmnopqrstuvwxyz",
    "01234567890",
    "qwertyuiop",
    "qwertzuiop",
    "asdfghjkl",
    "yxcvbnm",
    "zxcvbnm",
    "1qaz2wsx3edc4rfv5tgb6yhn",
)
AS_LETTERS = str.maketrans("013457@$!", "oleastasi")
"""Characters that commonly replace letters, mapped to these letters."""
WORDS = sorted(
    """password passwort passwd pass qwerty letmein welcome admin administrator changeme change default secret login iloveyou
    love monkey dragon sunshine princess football baseball master superman batman trustno shadow michael jennifer hunter
    summer winter spring autumn monday startracker tracker groundstation ground station satellite spacecraft space gss
    operator engineer viewer manager catalogue root user test guest""".split(),  # noqa: SIM905 - a list to read
    key=len,
    reverse=True,
)


def normalized(password: str) -> str:
    """Return the password in Unicode form NFKC. Input of more than twice the maximum length is truncated, because it will be
    rejected."""
    return unicodedata.normalize("NFKC", password[: 2 * LONGEST])


def why_guessable(password: str, name: str) -> str:
    """Return the reason why a normalized password is easy to guess, "" if it is not. The text does not contain the password."""
    plain = password.lower()
    if len(set(plain)) < MIN_DIFFERENT:
        return "few different characters"
    if plain.isdigit():
        return "digits only"
    if plain in (plain + plain)[1:-1]:
        return "a repeated part"
    if _neighbours(plain) >= SEQUENCE_SHARE * (len(plain) - 1):
        return "a sequence of keys or letters"
    if name and plain in (name.lower(), name.lower()[::-1]):
        return "the user name"
    remaining = _without_words(plain, name)
    if len(remaining) < MIN_LETTERS:
        return "a common word or the user name with few other characters"
    return ""


def _neighbours(plain: str) -> int:
    pairs = [plain[k : k + 2] for k in range(len(plain) - 1)]
    return sum(p[0] == p[1] or any(p in row or p[::-1] in row for row in SEQUENCES) for p in pairs)


def _without_words(plain: str, name: str) -> str:
    """Return the letters of a password without common words and the user name. If the password contains none of these,
    return all of its characters."""
    letters = "".join(c for c in plain.translate(AS_LETTERS) if c.isalpha())
    remaining = letters
    for word in ("".join(c for c in name.lower() if c.isalpha()), *WORDS):
        remaining = remaining.replace(word, "") if len(word) > 2 else remaining
    return remaining if remaining != letters else plain
