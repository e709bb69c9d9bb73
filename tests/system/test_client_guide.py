"""The code in docs/client.md and docs/morning.ipynb works unchanged with a server that restarts meanwhile."""

from __future__ import annotations

import ast
import json
import re
from pathlib import Path
from typing import Any

import pytest

from gss.client import ProcedureFailed

pytestmark = pytest.mark.timeout(600)
DOCS = Path(__file__).parents[2] / "docs"
PROCEDURE = """# Look at the sensor

## status: Ask for the status

```command
GET_STATUS
```

## free: May the cycle be stopped?

```question
Is the sensor free?
yes: next
no: end
```

## second: A second person looks

```hold
Everything is in order.
```
"""


def ten_lines() -> tuple[ast.Module, list[ast.stmt]]:
    """Return the head of the guide's first script, and the statements in its ``with`` block."""
    script = re.findall(r"```python\n(.*?)```", (DOCS / "client.md").read_text("utf-8"), re.DOTALL)[0]
    assert len(script.strip().splitlines()) <= 10
    module = ast.parse(script)
    block = module.body.pop()
    assert isinstance(block, ast.With)
    return module, block.body


def run(code: list[ast.stmt], names: dict[str, Any]) -> None:
    exec(compile(ast.Module(code, []), "client.md", "exec"), names)  # noqa: S102 - the guide of this repository


def test_the_guides_scripts_run_while_the_server_restarts(serve, monkeypatch, capsys) -> None:
    """The script of the guide continues after a restart of the server, and the notebook solves and calibrates.
    Procedures run and stop at steps that need a person.
    """
    server = serve("--simulator", "cubestar")
    port = server.console.address.rsplit(":", 1)[1].strip("/")
    key = server.console.post("/tokens", {"name": "guide", "role": "admin", "days": 1})["key"]
    monkeypatch.setenv("GSS_ADDRESS", f"http://127.0.0.1:{port}")
    monkeypatch.setenv("GSS_TOKEN", key)
    head, body = ten_lines()
    names: dict[str, Any] = {}
    run(head.body, names)
    gss = names["gss"] = names["Client"](timeout_s=120, reconnect_s=120)
    with gss.authority():
        run(body[:2], names)
        server.stop()
        server = serve("--simulator", "cubestar", "--port", port)
        gss.wait_connected(60)
        run(body[1:], names)
        assert "solved" in capsys.readouterr().out

    notebook = json.loads((DOCS / "morning.ipynb").read_text("utf-8"))
    cells = [cell for cell in notebook["cells"] if cell["cell_type"] == "code"]
    assert not any(cell["outputs"] for cell in cells)
    morning: dict[str, Any] = {}
    for cell in cells[:-1]:
        exec("".join(cell["source"]), morning)  # noqa: S102 - the notebook of this repository
    printed = capsys.readouterr().out
    assert "solved" in printed
    assert morning["calibration"]["rms_px"] < 0.5
    assert len(morning["stars"]) > 5
    drawing = morning["Residuals"](morning["place"], morning["residual"], 1024, 512, 1.0)._repr_svg_()
    assert drawing.count("<circle") == len(morning["stars"])
    exec("".join(cells[-1]["source"]), morning)  # noqa: S102

    server.console.post("/procedures", {"text": PROCEDURE})
    with gss.authority():
        ended = gss.run_procedure("Look at the sensor", answers={"free": "no"})
        assert (ended.state, [e["step"] for e in ended.entries]) == ("completed", ["status", "free"])
        assert len(ended.sha256) == 64
        with pytest.raises(ProcedureFailed, match="a person must do this step \\(question\\)"):
            gss.run_procedure("Look at the sensor")
        with pytest.raises(ProcedureFailed, match="\\(hold\\)"):
            gss.run_procedure("Look at the sensor", answers={"free": "yes"})
    with pytest.raises(KeyError):
        gss.run_procedure("No such procedure")
    gss.close()
