"""Texts, names and messages use standard technical terms instead of private idiom."""

from __future__ import annotations

import re
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

WORDS: dict[str, str] = {
    r"tells?|told|telling": "reports, notifies, states",
    r"nobody|somebody|whoever|anybody": "no user, another user, the caller",
    r"anew": "again",
    r"(?<!there )(?:is|are|was|were) no(?= (?!longer|more|less|later))": "is not a valid …, has no …",
    r"of (?:its|their) own": "separate, own …",
    r"what (?:came|comes|went|goes)": "received data, input, output",
    r"stands?(?!-| for| out)": "is shown, is stored, applies",
    r"(?:goes|go|went|going) on": "continues",
    r"the look of": "appearance",
    r"a word of it": "a note",
    r"so many": "this number of",
    r"of before": "previous, earlier",
    r"hears?|heard": "receives",
    r"knock(?:s|ed|ing)?": "unauthenticated request",
    r"asked": "requested",
    r"a moment": "a time, interactive",
    r"by (?:itself|themselves)": "automatically",
}
"""Words to avoid, as regular expressions, and the terms to use instead."""


SCIENCE = ("device", "instruments", "skytables", "pipeline", "catalogue_tools", "domain")
"""Rooms of gss with separate areas below."""
APPLICATION = ("operations", "api", "cli", "store")
"""Rooms of gss with an area each."""

AREAS: dict[str, tuple[str, ...]] = {
    "root": ("*.md", ":!docs", ":!web", "Makefile"),
    "docs": ("docs/*.md", "web/README.md"),
    "deploy": ("deploy",),
    "gss": ("gss/*.py", *(f":!gss/{room}" for room in (*SCIENCE, *APPLICATION))),
    **{room: (f"gss/{room}/*.py",) for room in APPLICATION},
    "device": ("gss/device/*.py",),
    "science": tuple(f"gss/{room}/*.{kind}" for room in SCIENCE[1:] for kind in ("py", "yaml")),
    "migrations": ("migrations/*.py",),
    "validation": ("validation/*.py",),
    "tools": ("tools/*.py",),
    "tests": ("tests/*.py", ":!tests/house/test_language.py"),
    "web": ("web/*.ts", "web/*.svelte", "web/*.css", "web/index.html"),
    "settings": ("*.toml", ".pre-commit-config.yaml"),
}
"""Git path specifications of each area. Together they contain every tracked source file and document."""

STORED = "a key of stored job requests since 0.4"
API = "a field of the API since 0.4"
FILE = "the method of file objects"

ALLOWED: tuple[tuple[str, str, str], ...] = (
    ("gss/operations/accounts/users.py", "OF_SOFTWARE = (", "a reserved user name"),
    (
        "gss/api/guard/audit_log.py",
        'UNAUTHENTICATED = "nobody"',
        "the name in audit rows without a user, which are part of the hash chain",
    ),
    ("gss/operations/catalogues/build_catalogue.py", 'Literal["asked", "sensor", "usual"]', API),
    ("gss/operations/catalogues/build_catalogue.py", 'return request, "asked"', API),
    ("gss/api/schemas/catalogues.py", '"asked"', API),
    ("gss/api/schemas/catalogues.py", "(asked)", API),
    ("gss/operations/catalogues/build_catalogue.py", "asked: CatalogueRequest", STORED),
    ("gss/operations/catalogues/build_catalogue.py", "job.asked", STORED),
    ("gss/operations/catalogues/design.py", "asked: DesignQuestion", STORED),
    ("gss/operations/catalogues/design.py", "job.asked", STORED),
    ("gss/operations/job_rules.py", '"asked"', STORED),
    ("gss/operations/studies/campaigns.py", "asked: ExperimentsRequest", STORED),
    ("gss/operations/studies/campaigns.py", "request.asked", STORED),
    ("gss/operations/studies/reprocess.py", "asked: ReprocessRequest", STORED),
    ("gss/operations/studies/reprocess.py", "job.asked", STORED),
    ("gss/operations/studies/reprocess.py", '"asked"', STORED),
    ("gss/operations/frames/replay.py", '.get("told")', "a key of solutions that earlier versions stored"),
    ("gss/operations/line/capture_files.py", "file.tell()", FILE),
    ("gss/operations/telemetry/telemetry_export.py", "def tell(self)", FILE),
    ("tests/operations/test_stored_requests.py", '"asked": {', STORED),
    ("tests/operations/test_stored_requests.py", "catalogue.asked.name", STORED),
    ("tests/operations/test_stored_requests.py", '["design"]).asked', STORED),
    ("tests/operations/test_stored_requests.py", "reprocess.asked.contact", STORED),
    ("tests/conftest.py", 'getpwnam("nobody")', "the unprivileged user of Unix systems"),
    ("migrations/versions/0003_studies_and_bank_history.py", 'sa.Column("told"', "a column of this stored version"),
    ("migrations/versions/0023_reported_of_bank_history.py", "told", "the previous name of the column"),
    ("tests/store/test_store_migrations_with_data.py", '("bank_history", "told")', "the previous name of the column"),
)
"""Path, text of the line, and the reason why the word is the right one there."""

WORD_BREAK = re.compile(r"(?<=[a-z])_(?=[a-z])")
"""Underscore between the words of a name."""
CODE_SPAN = re.compile(r"^```.*?^```|`[^`\n]+`|\]\([^)]*\)", re.MULTILINE | re.DOTALL)
AVOIDED = re.compile("|".join(rf"(?<![A-Za-z])(?:{word})(?![A-Za-z])" for word in WORDS), re.IGNORECASE)


def tracked(root: Path, patterns: tuple[str, ...]) -> list[Path]:
    """Return the tracked files that match the patterns. Skips without git."""
    ran = subprocess.run(
        ["git", "ls-files", "-z", "--", *patterns], cwd=root, capture_output=True, text=True, check=False
    )
    if ran.returncode:
        pytest.skip("no git checkout")
    return [path for name in ran.stdout.split("\0") if name and (path := root / name).is_file()]


def findings(root: Path, patterns: tuple[str, ...]) -> Iterator[str]:
    """Yield ``path:line: word: line`` of each word to avoid, also in names of Python. Code and link targets in Markdown are
    not read."""
    for path in tracked(root, patterns):
        name = str(path.relative_to(root))
        allowed = [part for where, part, _ in ALLOWED if where == name]
        text = path.read_text("utf-8")
        if path.suffix == ".md":
            text = CODE_SPAN.sub(lambda code: "\n" * code[0].count("\n"), text)
        for number, line in enumerate(text.splitlines(), 1):
            if any(part in line for part in allowed):
                continue
            words = WORD_BREAK.sub(" ", line) if path.suffix == ".py" else line
            for match in AVOIDED.finditer(words):
                yield f"{name}:{number}: {match[0]}: {line.strip()[:100]}"


@pytest.mark.parametrize("name", AREAS)
def test_words_to_avoid_do_not_return(root: Path, name: str) -> None:
    """No file of the area contains one, except in allowed lines."""
    matches = list(findings(root, AREAS[name]))
    assert not matches, "\n".join(matches[:200])


def test_allowed_lines_exist_and_have_a_reason(root: Path) -> None:
    """The allow-list contains no line that was removed."""
    for name, part, reason in ALLOWED:
        assert part in (root / name).read_text("utf-8"), (name, part)
        assert reason


@pytest.mark.parametrize(
    "text",
    ["nobody is told", "the sensor goes on", "a bank of its own", "it is no bank", "_tell_status", "values of before"],
)
def test_idiom_is_recognised(text: str) -> None:
    """Words to avoid are found in sentences and in names."""
    assert AVOIDED.search(text)


@pytest.mark.parametrize("text", ["there is no bank", "it is no longer valid", "standard", "intelligent", "masked"])
def test_standard_terms_are_not_recognised(text: str) -> None:
    """Words that only contain a word to avoid are allowed."""
    assert not AVOIDED.search(text)
