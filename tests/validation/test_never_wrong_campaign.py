"""The file of a campaign: completed shards are stored, the others are run next, and a page reports both."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from gss.cli import main
from gss.domain.errors import BadInput, Conflict
from gss.operations.studies.executor import HereExecutor
from validation import never_wrong
from validation.fingerprint import fingerprint
from validation.never_wrong.campaign import CampaignSettings, campaigns, keys, run_campaign
from validation.never_wrong.faults import FAULTS
from validation.never_wrong.fixed_cases import FINGERPRINTS, FIXED_CASES, found_before
from validation.never_wrong.frames import FrameShard
from validation.never_wrong.lists import Shard, Verdicts
from validation.never_wrong.page import page
from validation.never_wrong.record import SIZES, CampaignBlock, CampaignRecord
from validation.never_wrong.search import search

LOCAL = HereExecutor()
STORED = Path(never_wrong.__file__).with_name("results.json")
SMALL = CampaignSettings(0, 13, 3, ("cubestar",), ("own",))


def test_an_interrupted_run_continues_where_it_ended(tmp_path: Path) -> None:
    """A second run of a completed campaign runs nothing, and a larger campaign runs only what is missing. The page has
    the results of both."""
    file = tmp_path / "folder" / "kept.json"
    assert run_campaign(SMALL, CampaignRecord(file), executor=LOCAL) == 1
    assert run_campaign(SMALL, CampaignRecord(file), executor=LOCAL) == 0
    assert run_campaign(replace(SMALL, frames=26), CampaignRecord(file), executor=LOCAL) == 1
    (block,) = CampaignRecord(file).blocks(3)
    assert (block.shards, block.cases) == ([(0, 1)], 26)
    text = page([block], 3, "kept.json")
    assert "| frame, blank |" in text
    assert f"{block.code}: 0 lists and 26 frames" in text
    assert "| cubestar | cubestar (own) | frames | 26 |" in text


def test_the_file_is_small_and_complete(tmp_path: Path) -> None:
    """Shards in any order are stored as ranges, with the sum of their counts. Results of other sources are separate."""
    file, verdicts = tmp_path / "kept.json", Verdicts({(0, 1, "none"): 2, (3, 0, "wrong"): 1}, ("a case",))
    record = CampaignRecord(file)
    for number in (0, 1, 5, 3, 4):
        record.add(Shard("aim", "own", 1, number), "first", verdicts)
    record.add(Shard("aim", "own", 1, 2), "second", verdicts)
    record.add(FrameShard("aim", "own", 1, 0), "second", verdicts)
    first, second, frames = CampaignRecord(file).blocks(1)
    assert (first.shards, first.cases, first.wrong) == ([(0, 1), (3, 5)], 15, ["a case"] * 5)
    assert (second.shards, second.code, frames.name) == ([(2, 2)], "second", "frames")
    assert CampaignRecord(file).completed() == {
        FrameShard("aim", "own", 1, 0),
        *(Shard("aim", "own", 1, n) for n in range(6)),
    }
    assert CampaignRecord(file).blocks(2) == []
    for code in ("first", "second"):
        with pytest.raises(Conflict, match="shard 4"):
            record.add(Shard("aim", "own", 1, 4), code, verdicts)


def test_selected_results_are_replaced(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """``--again`` reruns the selected chain, also after it gave a wrong result, and keeps the results of the others. It is
    rejected if results of the same chain that it does not rerun would be lost."""
    file = tmp_path / "kept.json"
    for camera, number in (("cubestar", 0), ("aim", 0), ("aim", 1)):
        CampaignRecord(file).add(
            FrameShard(camera, "own", 3, number), "old", Verdicts({(0, 0, "wrong"): 13}, (camera,))
        )
    before = file.read_text("utf-8")
    selected = ["--attitudes", "0", "--frames", "13", "--seed", "3", "--chain", "own", "--workers", "1", "--again"]
    command = ["experiments", "never-wrong", *selected, "--keep", str(file), "--camera"]
    assert main([*command, "aim"]) == 2
    assert "13 frames" in capsys.readouterr().err
    assert file.read_text("utf-8") == before
    assert main([*command, "cubestar"]) == 3
    others, rerun = CampaignRecord(file).blocks(3)
    assert (others.camera, others.wrong, others.code) == ("aim", ["aim", "aim"], "old")
    assert (rerun.camera, rerun.shards, rerun.wrong) == ("cubestar", [(0, 0)], [])


def test_a_page_needs_results(tmp_path: Path) -> None:
    """Without stored results there is no page, which would report that nothing was wrong."""
    page_file = tmp_path / "page.md"
    arguments = ["experiments", "never-wrong", "--keep", str(tmp_path / "absent.json"), "--page", str(page_file)]
    assert main(arguments) == 2
    assert not page_file.exists()


@pytest.mark.parametrize(
    "change", [lambda text: text[:-20], lambda text: text.replace('"version": 1', '"version": 2'), lambda _: "[]"]
)
def test_a_file_that_is_not_a_record_is_rejected(tmp_path: Path, change: Callable[[str], str]) -> None:
    """A truncated file, one of another version and other JSON are rejected and left as they are."""
    file = tmp_path / "kept.json"
    CampaignRecord(file).add(Shard("aim", "own", 1, 0), "first", Verdicts({}, ()))
    file.write_text(change(file.read_text("utf-8")), "utf-8")
    before = file.read_text("utf-8")
    assert main(["experiments", "never-wrong", "--attitudes", "250", "--keep", str(file)]) == 2
    assert file.read_text("utf-8") == before


@pytest.mark.parametrize(("code", "shards", "match"), [("a", [7, 8], "block twice"), ("b", [5, 5], "shard 5 twice")])
def test_a_file_with_repeated_results_is_rejected(tmp_path: Path, code: str, shards: list[int], match: str) -> None:
    """Two blocks with one key, and a shard in two blocks, are rejected with the name of the second block. Before, the first block
    was lost, or the shard counted twice."""
    file = tmp_path / "kept.json"
    for number in (4, 5):
        CampaignRecord(file).add(Shard("aim", "own", 1, number), "a", Verdicts({(0, 0, "none"): 250}, ()))
    content = json.loads(file.read_text("utf-8"))
    content["blocks"].append(content["blocks"][0] | {"code": code, "shards": [shards]})
    file.write_text(json.dumps(content), "utf-8")
    with pytest.raises(BadInput, match=match) as error:
        CampaignRecord(file)
    assert f"lists of aim, own, seed 1, sources {code}" in str(error.value.got)


def test_a_page_does_not_replace_the_stored_results(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """One file for page and results is rejected, also under another name."""
    file, link, hard_link = (tmp_path / name for name in ("kept.json", "link.json", "hard_link.json"))
    CampaignRecord(file).add(Shard("aim", "own", 1, 0), "first", Verdicts({(0, 0, "none"): 250}, ()))
    before = file.read_bytes()
    link.symlink_to(file)
    hard_link.hardlink_to(file)
    for page_file in (file, tmp_path / ".." / tmp_path.name / "kept.json", link, hard_link):
        for command in (["never-wrong"], ["run", "erlank-6-1", "--trials", "1"]):
            assert main(["experiments", *command, "--keep", str(file), "--page", str(page_file)]) == 2
            assert "the same file" in capsys.readouterr().err
            assert file.read_bytes() == before


def test_two_runs_with_one_file_lose_nothing(tmp_path: Path) -> None:
    """A run ends if another one has added results to its file."""
    file, verdicts = tmp_path / "kept.json", Verdicts({(0, 0, "none"): 13}, ())
    first, second = CampaignRecord(file), CampaignRecord(file)
    first.add(FrameShard("aim", "own", 1, 0), "code", verdicts)
    with pytest.raises(Conflict, match="another run"):
        second.add(FrameShard("aim", "own", 1, 1), "code", verdicts)
    first.add(FrameShard("aim", "own", 1, 1), "code", verdicts)
    assert len(CampaignRecord(file).completed()) == 2


def test_a_wrong_solution_is_listed_and_gives_exit_code_3(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A wrong solution is listed on the page, and the exit code of the command is 3."""
    file, page_file = tmp_path / "kept.json", tmp_path / "page.md"
    CampaignRecord(file).add(
        FrameShard("cubestar", "own", 3, 0), "first", Verdicts({(0, 0, "wrong"): 13}, ("cubestar, planted",))
    )
    assert main(["experiments", "never-wrong", "--seed", "3", "--keep", str(file), "--page", str(page_file)]) == 3
    assert "cubestar, planted" in capsys.readouterr().out
    assert "- cubestar, planted" in page_file.read_text("utf-8")


def test_invalid_campaigns_are_rejected() -> None:
    """Unknown and repeated cameras and negative numbers are rejected. All shards of a campaign are different."""
    with pytest.raises(BadInput, match="camera"):
        CampaignSettings(cameras=("hubble",))
    with pytest.raises(BadInput, match="camera is selected twice"):
        CampaignSettings(cameras=("aim", "aim"))
    with pytest.raises(BadInput, match="attitudes"):
        CampaignSettings(attitudes=-1)
    with pytest.raises(BadInput, match="seed"):
        CampaignSettings(seed=-1)
    assert len(set(keys(CampaignSettings()))) == len(keys(CampaignSettings())) == (40 + 10) * 5 * 2


def test_a_search_solves_the_campaigns_lists_with_the_selected_faults(capsys: pytest.CaptureFixture[str]) -> None:
    """The counts of a search equal those of the campaign's shards for the same faults. The command rejects unknown faults
    and an empty range."""
    settings, reports = CampaignSettings(500, 0, 1, ("cubestar",), ("own",)), []
    verdicts = search(settings, ("mirrored",), 250, executor=LOCAL, report=reports.append)
    shard = campaigns()[0].run(Shard("cubestar", "own", 1, 1))
    mirrored = [fault.title for fault in FAULTS].index("mirrored")
    assert verdicts.counts == {cell: n for cell, n in shard.counts.items() if cell[0] == mirrored}
    assert 0 < sum(verdicts.counts.values()) < 20
    assert list(verdicts.wrong) == reports == []
    for options in (["--fault", "no such fault"], ["--first", "500"], ["--first", "-1"]):
        assert main(["experiments", "search-wrong", "--attitudes", "500", *options]) == 2
    assert "Unknown fault" in capsys.readouterr().err


def _solved(code: str, first: int, last: int, seed: int = 1) -> CampaignBlock:
    """Return the solved lists of AIM's chain in a range of shards."""
    return CampaignBlock(Shard, "aim", "own", seed, code, [(first, last)], Counter({(0, 0, "correct"): 1000}))


OLD, NEW = FINGERPRINTS[0], FINGERPRINTS[-1]


@pytest.mark.parametrize(
    ("blocks", "count"),
    [
        ([_solved(OLD, 0, 9), _solved(NEW, 10, 3999)], 5),  # 4085 and 5417 were corrected before OLD
        ([_solved(OLD, 0, 9), _solved(NEW, 10, 200)], 2),  # 15013 and 38936; the others are not in the results
        ([_solved(OLD, 0, 199), _solved(NEW, 200, 3999)], 3),  # the results of OLD contain the verdicts of these two
        ([_solved(OLD, 0, 3999)], 0),
        ([_solved(NEW, 0, 3999)], 0),
        ([_solved("unknown", 0, 3999)], 0),  # one state of the sources: all verdicts are in the results
        ([_solved(OLD, 0, 9), _solved(fingerprint(), 10, 3999)], 5),  # the present sources have every correction
        ([_solved("unknown", 0, 9), _solved(NEW, 10, 3999)], 7),
        ([_solved(OLD, 0, 9), _solved("unknown", 10, 3999)], 7),  # may be from before OLD
        ([_solved(OLD, 0, 9, 2), _solved(NEW, 10, 3999, 2)], 0),
    ],
)
def test_limits_count_a_corrected_case_if_other_results_are_from_before(
    blocks: list[CampaignBlock], count: int
) -> None:
    """A case counts only for its seed, and only if its own list was solved again and others were not. Sources of unknown order
    can be from before or after a correction, and the page names them."""
    assert found_before(blocks) == Counter({("lists", "aim", "own"): count})
    text = page(blocks, blocks[0].seed, "kept.json")
    assert f"| {count} | < " in text
    codes = {b.code for b in blocks}
    assert ("sources unknown is unknown" in text) == ("unknown" in codes and len(codes) > 1)


def test_corrected_cases_agree_with_the_stored_results() -> None:
    """All stored sources have a place in the order, and the list of each case was solved with its correction. The counts of each
    camera and chain are those that follow from the commits of the corrections."""
    blocks = CampaignRecord(STORED).blocks(1)
    assert {block.code for block in blocks} <= set(FINGERPRINTS)
    for case in FIXED_CASES:
        for key, numbers in case.found.items():
            for number in (n for n in numbers if n is not None):
                (code,) = [
                    b.code for b in blocks if (b.name, b.camera, b.chain) == key and b.contains(number // SIZES[key[0]])
                ]
                assert FINGERPRINTS.index(code) >= FINGERPRINTS.index(case.corrected_in), (key, number)
    assert {key: count for key, count in found_before(blocks).items() if count} == {
        ("lists", "aim", "own"): 5,
        ("lists", "aim", "reference"): 2,
        ("lists", "cubestar", "own"): 1,
        ("lists", "cubestar", "reference"): 2,
        ("lists", "far_mst", "own"): 3,
        ("lists", "oersted", "reference"): 1,
        ("lists", "sunsat", "reference"): 1,
    }
