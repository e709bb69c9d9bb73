"""The file of a campaign: completed shards are stored, the others are run next, and a page reports both."""

from __future__ import annotations

from pathlib import Path

import pytest

from gss.cli import main
from gss.domain.errors import BadInput
from gss.operations.studies.executor import HereExecutor
from validation.never_wrong.campaign import CampaignSettings, keys, read, run_campaign
from validation.never_wrong.page import page

LOCAL = HereExecutor()
SMALL = CampaignSettings(0, 13, 3, ("cubestar",), ("own",))


def test_an_interrupted_run_continues_where_it_ended(tmp_path: Path) -> None:
    """A second run of a completed campaign runs nothing. A shard whose line is truncated is run again."""
    file = tmp_path / "kept.jsonl"
    assert run_campaign(SMALL, file, executor=LOCAL) == 1
    assert run_campaign(SMALL, file, executor=LOCAL) == 0
    content = file.read_text("utf-8")
    file.write_text(content[: len(content) // 2] + "\n", "utf-8")
    assert run_campaign(SMALL, file, executor=LOCAL) == 1
    (record,) = read(file).values()
    assert sum(n for *_, n in record["counts"]) == 13
    text = page(SMALL, read(file))
    assert "| frame, blank |" in text
    assert record["code"] in text
    assert "| cubestar | cubestar (own) | frames | 13 |" in text


def test_a_wrong_solution_is_listed_and_gives_exit_code_3(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A wrong solution is listed on the page, and the exit code of the command is 3."""
    file, page_file = tmp_path / "kept.jsonl", tmp_path / "page.md"
    run_campaign(SMALL, file, executor=LOCAL)
    file.write_text(file.read_text("utf-8").replace('"wrong": []', '"wrong": ["cubestar, planted"]'), "utf-8")
    arguments = ["--attitudes", "0", "--frames", "13", "--seed", "3", "--camera", "cubestar", "--chain", "own"]
    assert main(["experiments", "never-wrong", *arguments, "--keep", str(file), "--page", str(page_file)]) == 3
    assert "cubestar, planted" in capsys.readouterr().out
    assert "- cubestar, planted" in page_file.read_text("utf-8")


def test_invalid_campaigns_are_rejected() -> None:
    """Unknown cameras and negative numbers are rejected. All shards of a campaign are different."""
    with pytest.raises(BadInput, match="camera"):
        CampaignSettings(cameras=("hubble",))
    with pytest.raises(BadInput, match="attitudes"):
        CampaignSettings(attitudes=-1)
    assert len(set(keys(CampaignSettings()))) == len(keys(CampaignSettings())) == (40 + 10) * 5 * 2
