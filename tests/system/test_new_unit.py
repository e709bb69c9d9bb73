"""A new user connects NOS3 as docs/instruments.md describes, beside units whose lines are faulty."""

from __future__ import annotations

import re
import shlex
import socket
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytestmark = pytest.mark.timeout(600)
LONG_S = 300.0


@pytest.fixture
def commands(root: Path) -> dict[str, list[str]]:
    """Arguments of the first commands of the page, by the name of the command."""
    text = (root / "docs" / "instruments.md").read_text("utf-8")
    section = text.split("## An instrument without code", 1)[1].split("| instrument |", 1)[0]
    lines = re.findall(r"^gss (.+)$", "\n".join(re.findall(r"```\n(.*?)```", section, re.DOTALL)), re.MULTILINE)
    return {words[0]: words for words in map(shlex.split, lines)}


@pytest.fixture
def noise() -> Iterator[str]:
    """Address of a line on which random bytes arrive."""
    with socket.create_server(("127.0.0.1", 0)) as listener:
        ended = threading.Event()

        def send() -> None:
            rng = np.random.default_rng(1)
            while not ended.is_set():
                try:
                    peer, _ = listener.accept()
                    with peer:
                        while not ended.wait(0.02):
                            peer.sendall(rng.bytes(500))
                except OSError:
                    continue  # the server closed the line, or the test has ended

        listener.settimeout(0.5)
        thread = threading.Thread(target=send)
        thread.start()
        yield f"socket://127.0.0.1:{listener.getsockname()[1]}"
        ended.set()
        thread.join()


def test_nos3_is_connected_as_documented_beside_faulty_lines(
    commands: dict[str, list[str]], run_gss: Callable[..., Any], serve: Callable[..., Any], noise: str
) -> None:
    """The printed commands give a unit with its attitude. Of two units at one address, one works and the other one states
    that the line is in use; a unit whose line carries noise states that no packet is valid.
    """
    simulator = run_gss(*commands["simulate"][:-1], "0")
    assert simulator.stdout is not None
    url = next(line for line in simulator.stdout if line.startswith("READY")).split()[1]
    checked = run_gss(*(url if "://" in word else word for word in commands["check"]))
    assert checked.stdout is not None
    findings = checked.stdout.read().splitlines()
    assert [line for line in findings[1:-1] if not line.startswith("pass ")] == []
    assert findings[-1].endswith("0 failed")

    unit, _ = commands["serve"][-1].split("@")
    lines = {unit: url, "TWIN=nos3": url.replace("127.0.0.1", "localhost"), "NOISE=nos3": noise}
    server = serve(*(word for name, line in lines.items() for word in ("--unit", f"{name}@{line}")))
    console = server.console

    def links() -> dict[str, Any]:
        return {u["name"]: u["link"] for u in console.get("/fleet")["units"] if u["current"]}

    def faulty(name: str, words: str) -> bool:
        link = links().get(name)
        return link is not None and not link["profile"] and any(words in a["text"] for a in link["alarms"])

    name, link = console.wait(
        "an attitude", lambda: next(((n, u) for n, u in links().items() if u["attitude"]), None), LONG_S
    )
    assert (link["rx"]["state"], link["simulated"], link["profile"]) == ("up", None, "nos3")
    other = ({"FM1", "TWIN"} - {name}).pop()
    console.wait("the line in use", lambda: faulty(other, "another program may be using the line"), LONG_S)
    console.wait("invalid bytes", lambda: faulty("NOISE", "check the line rate and the instrument"), LONG_S)
