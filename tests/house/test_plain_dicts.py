"""Records are typed: ``dict[str, Any]`` is for JSON whose form is not known, and its number can only fall."""

from __future__ import annotations

import re
from collections import Counter
from pathlib import Path

PLAIN = re.compile(r"\bdict\[str, Any\]")
MOST = {
    "gss/api": (37, "JSON columns of the store in responses, errors of pydantic, ASGI scopes"),
    "gss/catalogue_tools": (45, "manifests and parameters as written to files of several versions"),
    "gss/cli": (13, "facts printed as JSON"),
    "gss/device": (22, "values by field of the dictionary; attributes of XML elements"),
    "gss/domain": (2, "a camera as stored"),
    "gss/instruments": (2, "YAML and XML before they are validated"),
    "gss/operations": (131, "checkpoints and stored requests of jobs; columns of rows; content of stored reports"),
    "gss/pipeline": (1, "a calibration as stored"),
    "gss/store": (45, "JSON columns, and values of rows by column"),
    "tools": (13, "results of measurements, written as JSON"),
    "validation": (7, "results of experiments, written as JSON"),
}
"""Number of uses in a folder, and what they are."""


def test_plain_dicts_do_not_grow(root: Path) -> None:
    """A new record is a frozen dataclass, a TypedDict or a pydantic model. Lower the number when you convert one."""
    uses: Counter[str] = Counter()
    for top in ("gss", "tools", "validation"):
        for path in (root / top).rglob("*.py"):
            parts = path.relative_to(root).parts
            uses["/".join(parts[:2]) if top == "gss" else top] += len(PLAIN.findall(path.read_text("utf-8")))
    more = {folder: n for folder, n in uses.items() if n > MOST.get(folder, (0, ""))[0]}
    assert not more, f"more than { ({folder: MOST.get(folder, (0, ''))[0] for folder in more}) }: {more}"
