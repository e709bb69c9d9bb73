"""Experiments selected by name: text, pages, JSON, and stored runs."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

import validation
from gss.cli import main
from gss.domain.errors import BadInput, NotFound
from gss.domain.experiment import share_interval
from validation.entries import ENTRIES
from validation.fingerprint import STORAGE, fingerprint
from validation.result_store import ResultStore, StoredRun, as_page, as_text
from validation.run import default_trials, from_record, run_experiment


def test_an_unknown_name_lists_the_known_ones() -> None:
    """An unknown name is rejected with a list of the valid ones."""
    with pytest.raises(NotFound, match="jacobs-5-1"):
        run_experiment("no-such")


def test_invalid_trials_and_seeds_are_rejected() -> None:
    """Zero trials and a negative seed are rejected."""
    with pytest.raises(BadInput, match="trials"):
        run_experiment("erlank-3-6", trials=0)
    with pytest.raises(BadInput, match="seed"):
        run_experiment("erlank-3-6", trials=10, seed=-1)


def test_the_same_seed_gives_the_same_figures() -> None:
    """Two runs are equal; another seed differs."""
    first, second, other = (run_experiment("erlank-3-6", trials=300, seed=s) for s in (3, 3, 4))
    assert first == second
    assert first.rows != other.rows


@pytest.mark.parametrize("name", ["jacobs-5-1", "jacobs-5-2", "erlank-3-6", "erlank-fig-3-8"])
def test_catalogue_tables_are_close_to_the_papers(name: str) -> None:
    """Every figure above 25 in the paper is reproduced within 30 %."""
    experiment = run_experiment(name, trials=4000, seed=1)
    compared = 0
    for label, paper, reproduced, *_ in experiment.rows:
        if isinstance(paper, int | float) and paper > 25 and isinstance(reproduced, int | float):
            assert reproduced == pytest.approx(paper, rel=0.3), label
            compared += 1
    assert compared or name == "erlank-fig-3-8"


def test_every_experiment_prints_text_and_page() -> None:
    """The text and the page contain the label of each row and the source."""
    experiment = run_experiment("erlank-3-6", trials=50)
    page = as_page([StoredRun(experiment, 50, 1.2, fingerprint())], "0")
    assert f"sources {fingerprint()}" in page
    for text in (as_text(experiment), page):
        assert "Erlank 2013 Table 3.6" in text
        assert all(str(row[0]) in text for row in experiment.rows)


def test_the_command_line_prints_json(capsys: pytest.CaptureFixture[str]) -> None:
    """JSON output has one object per experiment with the figures of the paper and of GSS. An unknown name gives exit
    code 2.
    """
    assert main(["experiments", "run", "erlank-3-6", "--trials", "50", "--json"]) == 0
    record = json.loads(capsys.readouterr().out)
    assert record["name"] == "erlank-3-6"
    assert record["columns"][1:3] == ["paper", "ours"]
    assert main(["experiments", "list"]) == 0
    listed = capsys.readouterr().out
    assert all(name in listed for name in ENTRIES)
    assert main(["experiments", "run", "nothing"]) == 2


def test_shares_have_wilson_intervals() -> None:
    """The interval for 8 of 10 is the textbook value, 0.490 to 0.943."""
    low, high = share_interval(8, 10)
    assert (low, high) == pytest.approx((0.4902, 0.9433), abs=1e-3)


def test_stored_runs_are_not_repeated(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A second run uses the stored table, even if the file has a truncated line. Another number of trials is run and
    stored after that line.
    """
    store, page = tmp_path / "kept.jsonl", tmp_path / "page.md"
    arguments = ["experiments", "run", "erlank-3-6", "--keep", str(store), "--trials"]
    assert main([*arguments, "50", "--json"]) == 0
    first = capsys.readouterr().out
    with store.open("ab") as file:
        file.write('{"trials": 50, "torn ″'.encode()[:-1])
    assert main([*arguments, "50", "--json"]) == 0
    assert capsys.readouterr().out == first
    assert len(store.read_bytes().splitlines()) == 2, "one stored run and one truncated line"
    assert main([*arguments, "60", "--page", str(page)]) == 0
    assert len(store.read_bytes().splitlines()) == 3
    assert ResultStore(store).get("erlank-3-6", 60, 1) is not None
    assert "gss experiments run erlank-3-6 --page" in page.read_text()
    assert "`erlank-3-6` ran with `--trials 60`" in page.read_text()
    assert "s of processor time" in page.read_text()
    assert from_record(json.loads(first)) == run_experiment("erlank-3-6", trials=50)


def test_a_longer_stored_run_is_reused_without_a_number_of_trials(tmp_path: Path) -> None:
    """A stored run with at least the default number of trials is reused if no number is given, and the page states its number."""
    store, page = tmp_path / "kept.jsonl", tmp_path / "page.md"
    experiment, trials = run_experiment("erlank-3-6", trials=50), default_trials("erlank-3-6")
    for extra in (-1, 2, 1):
        ResultStore(store).keep(StoredRun(experiment, trials + extra, 1.0, "0" * 12))
    assert main(["experiments", "run", "erlank-3-6", "--keep", str(store), "--page", str(page)]) == 0
    assert len(store.read_bytes().splitlines()) == 3
    assert f"`erlank-3-6` ran with `--trials {trials + 2}`" in page.read_text()


@pytest.mark.parametrize("option", ["--page", "--keep"])
def test_an_output_file_that_cannot_be_written_is_rejected_before_the_runs(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], option: str
) -> None:
    """A page or store in a missing folder, or with the name of a folder, is rejected before an experiment runs."""
    for file in (tmp_path / "absent" / "file", tmp_path):
        assert main(["experiments", "run", "erlank-3-6", "--trials", "50", "--json", option, str(file)]) == 2
        output = capsys.readouterr()
        assert output.out == ""
        assert str(file) in output.err


def test_lists_without_a_star_are_identified_at_most_as_often_as_stated() -> None:
    """At a limit of 0.1, at most a tenth of the random lists are identified. The expected number over the whole sky is four."""
    experiment = run_experiment("false-match", trials=8)
    assert len(experiment.rows) == 5 * 3 * 2 + 2
    whole_sky, near = (int(str(row[3]).partition(" ")[0]) for row in experiment.rows[-2:])
    assert 0 < whole_sky <= 0.1 * 8 * 15
    assert near <= 0.02 * 8 * 15


def test_files_without_influence_on_results_are_not_in_the_fingerprint(monkeypatch: pytest.MonkeyPatch) -> None:
    """A change of the page's texts, or of the corrected cases that it lists, does not change the fingerprint, and a change of the
    lists does. All files that are left out exist."""
    before, read = fingerprint(), Path.read_bytes
    root = Path(validation.__file__).parents[1]
    assert all((root / name).is_file() for name in STORAGE)
    for name, is_equal in (("page.py", True), ("fixed_cases.py", True), ("lists.py", False)):
        monkeypatch.setattr(Path, "read_bytes", lambda path, name=name: read(path) + b"#" * (path.name == name))
        assert (fingerprint() == before) == is_equal, name
