"""The list of frames: filters, alone or combined, and pages of thousands of frames."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta

import pytest
from sqlalchemy.orm import Session

from gss.store import frames
from gss.store.engine import Database, open_engine
from gss.store.migration import migrate
from gss.store.models import Frame, Solution

START = datetime(2026, 11, 21, 18, 0, tzinfo=UTC)


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory):
    """Session with 3000 frames, one per second, in two modes. Every third frame has no result, and every fifth of the
    others has no attitude. The number of stars is 0 to 19.
    """
    url = f"sqlite:///{tmp_path_factory.mktemp('frames') / 'gss.db'}"
    migrate(url)
    database = Database(open_engine(url))
    with database.unit_of_work() as session:
        session.add_all(frame(k) for k in range(1, 3001))
        session.flush()
        session.add_all(result(k) for k in range(1, 3001) if k % 3)
        # A newer result that is not operational has no effect on the filters.
        session.add(result(2, matched=99, operational=False))
    with database.unit_of_work() as session:
        yield session
    database.close()


def frame(k: int) -> Frame:
    """Return the k-th frame."""
    taken = START + timedelta(seconds=k)
    mode, source = ("tracking" if k % 2 else "assisted"), ("import" if k == 7 else "device")
    shape = {"columns": 8, "rows": 4, "bits": 8, "dtype": "|u1", "sha256": "0" * 64, "complete": True}
    return Frame(id=k, source=source, name="", taken=taken, received=taken, mode=mode, **shape)


def result(k: int, matched: int | None = None, operational: bool = True) -> Solution:
    """Return the ground result of the k-th frame."""
    outcome, verdict = ("none", "none") if k % 5 == 0 else ("solved", "wrong" if k % 100 == 1 else "correct")
    common = {"chain": "reference", "version": "1", "created": START, "origin": "ground", "detail": {}, "timing_s": {}}
    return Solution(
        frame_id=k,
        outcome=outcome,
        verdict=verdict,
        matched=k % 20 if matched is None else matched,
        operational=operational,
        **common,
    )


def ids(session: Session, **filters: object) -> set[int]:
    """Return the ids of all frames that pass the filter."""
    total, rows = frames.page(session, 5000, 0, **filters)
    assert total == len(rows)
    return {row.id for row in rows}


def test_without_filters_all_frames_are_listed_newest_first(session):
    """A page in the middle has the expected frames, newest first, and the total number of frames."""
    total, rows = frames.page(session, 50, 2000)
    assert total == 3000
    assert [row.id for row in rows] == list(range(1000, 950, -1))


@pytest.mark.parametrize(
    ("filters", "passes"),
    [
        ({"outcome": "unsolved"}, lambda k: k % 3 == 0),
        ({"outcome": "none"}, lambda k: k % 3 and k % 5 == 0),
        ({"outcome": "solved"}, lambda k: k % 3 and k % 5),
        ({"outcome": "wrong"}, lambda k: k % 3 and k % 5 and k % 100 == 1),
        ({"mode": "assisted"}, lambda k: k % 2 == 0),
        ({"source": "import"}, lambda k: k == 7),
        ({"least_stars": 15}, lambda k: k % 3 and k % 20 >= 15),
        ({"most_stars": 3}, lambda k: k % 3 and k % 20 <= 3),
        ({"start": START + timedelta(seconds=10), "end": START + timedelta(seconds=20)}, lambda k: 10 <= k < 20),
        (
            {"mode": "tracking", "outcome": "solved", "least_stars": 10},
            lambda k: k % 2 and k % 3 and k % 5 and k % 20 >= 10,
        ),
    ],
)
def test_filters_select_the_matching_frames(session, filters, passes):
    """Filters select the matching frames, alone and combined. Outcome and stars are those of the operational ground
    result."""
    assert ids(session, **filters) == {k for k in range(1, 3001) if passes(k)}


def test_modes_are_those_of_all_frames(session):
    """The list has the modes of all frames, not only of one page."""
    assert frames.modes(session) == ["assisted", "tracking"]


def test_attitudes_of_sensor_and_ground_are_paired(session):
    """The newest frames with an on-board and a ground attitude are listed, newest first, with the newer of two on-board
    results."""
    common = {"chain": "cubestar", "version": "1", "created": START, "origin": "on board", "detail": {}, "timing_s": {}}
    for k, outcome in ((1, "solved"), (4, "solved"), (4, "solved"), (8, "none"), (10, "solved")):
        session.add(Solution(frame_id=k, outcome=outcome, **common))
        session.flush()
    pairs = frames.attitude_pairs(session, 100)
    assert [frame.id for frame, _, _ in pairs] == [4, 1]  # 10 has no ground attitude
    assert pairs[0][1].id > pairs[1][1].id + 1
    assert pairs[0][2].operational
    # The limit applies to frames, not to results.
    assert [frame.id for frame, _, _ in frames.attitude_pairs(session, 2)] == [4, 1]
