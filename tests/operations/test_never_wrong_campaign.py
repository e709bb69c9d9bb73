"""The campaign's file: what is done is kept, the rest is done next, a page says both."""

from __future__ import annotations

from pathlib import Path

import pytest

from gss.cli import main
from gss.domain.errors import BadInput
from gss.operations.studies.executor import HereExecutor
from gss.operations.studies.never_wrong import Hunt, hunt, keys, read
from gss.operations.studies.never_wrong_page import page

LOCAL = HereExecutor()
SMALL = Hunt(0, 13, 3, ("cubestar",), ("own",))


def test_a_cut_run_goes_on_where_it_ended(tmp_path: Path) -> None:
    """A second run does nothing, a torn last line is done again, and asked again everything is."""
    file = tmp_path / "kept.jsonl"
    assert hunt(SMALL, file, executor=LOCAL) == 1
    assert hunt(SMALL, file, executor=LOCAL) == 0
    whole = file.read_text("utf-8")
    file.write_text(whole[: len(whole) // 2] + "\n", "utf-8")
    assert hunt(SMALL, file, executor=LOCAL) == 1
    (record,) = read(file).values()
    assert sum(n for *_, n in record["counts"]) == 13
    text = page(SMALL, read(file))
    assert "| frame, blank |" in text
    assert record["code"] in text
    assert "| cubestar | cubestar (own) | frames | 13 |" in text


def test_a_wrong_answer_is_named_and_ends_with_3(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The page lists it and the command's exit code tells."""
    file, out = tmp_path / "kept.jsonl", tmp_path / "page.md"
    hunt(SMALL, file, executor=LOCAL)
    file.write_text(file.read_text("utf-8").replace('"wrong": []', '"wrong": ["cubestar, planted"]'), "utf-8")
    told = ["--attitudes", "0", "--frames", "13", "--seed", "3", "--camera", "cubestar", "--chain", "own"]
    assert main(["experiments", "never-wrong", *told, "--keep", str(file), "--page", str(out)]) == 3
    assert "cubestar, planted" in capsys.readouterr().out
    assert "- cubestar, planted" in out.read_text("utf-8")


def test_impossible_hunts_are_refused() -> None:
    """Unknown cameras and negative numbers are told; a hunt's shards are all different."""
    with pytest.raises(BadInput, match="camera"):
        Hunt(cameras=("hubble",))
    with pytest.raises(BadInput, match="attitudes"):
        Hunt(attitudes=-1)
    assert len(set(keys(Hunt()))) == len(keys(Hunt())) == (40 + 10) * 5 * 2
