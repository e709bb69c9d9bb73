"""Records are typed.

``dict[str, Any]`` and JsonObject are used only for JSON of unknown structure, and the number of uses may only
decrease.
"""

from __future__ import annotations

import re
from collections import Counter
from pathlib import Path

PLAIN = re.compile(r"\bdict\[str, Any\]")
MOST = {
    "gss/api": (7, "arguments of uvicorn, FastAPI and pydantic.create_model; ASGI state"),
    "gss/domain": (1, "the definition of JsonObject"),
    "tools": (13, "results of measurements, written as JSON"),
    "validation": (7, "results of experiments, written as JSON"),
}
"""Number of uses in a folder, and their purpose."""
PASSED_ON = re.compile(r"\bJsonObject\b")
MAX_PASSED_ON = {
    "gss/api": (18, "JSON columns of the store in responses"),
    "gss/catalogue_tools": (19, "manifests and parameters as written to files of several versions"),
    "gss/instruments": (1, "XML before it is validated"),
    "gss/domain": (3, "its definition; a camera as stored"),
    "gss/operations": (67, "checkpoints, stored requests and results of jobs; header of an image file"),
    "gss/store": (40, "JSON columns"),
}
"""The same for JSON objects that the code passes through unchanged."""


def test_plain_dicts_do_not_grow(root: Path) -> None:
    """No folder has more uses than its limit.

    Define a new record as a frozen dataclass, a TypedDict or a pydantic model, and lower the limit after converting
    one.
    """
    for pattern, limits in ((PLAIN, MOST), (PASSED_ON, MAX_PASSED_ON)):
        uses: Counter[str] = Counter()
        for top in ("gss", "tools", "validation"):
            for path in (root / top).rglob("*.py"):
                parts = path.relative_to(root).parts
                lines = [line for line in path.read_text("utf-8").splitlines() if not line.startswith("from ")]
                uses["/".join(parts[:2]) if top == "gss" else top] += len(pattern.findall("\n".join(lines)))
        exceeded = {folder: n for folder, n in uses.items() if n > limits.get(folder, (0, ""))[0]}
        assert not exceeded, (
            f"more than { ({folder: limits.get(folder, (0, ''))[0] for folder in exceeded}) }: {exceeded}"
        )
