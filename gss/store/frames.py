"""Frames and their solutions."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime
from typing import Any, NamedTuple

from sqlalchemy import exists, func, insert, select, update
from sqlalchemy.orm import Session, aliased, defer

from gss.domain.errors import NotFound
from gss.domain.results import BLIND
from gss.store.models import Frame, Solution


def add(session: Session, frame: Frame) -> Frame:
    """Store a frame's row and assign its id."""
    session.add(frame)
    session.flush()
    return frame


def get(session: Session, frame_id: int) -> Frame:
    """Return the frame with that id. Raises NotFound if it does not exist."""
    row = session.get(Frame, frame_id)
    if row is None:
        raise NotFound(
            "no such frame",
            got=str(frame_id),
            hint="use the number in the page's address, not the number assigned by the sensor",
        )
    return row


def latest(session: Session) -> Frame | None:
    """Return the most recently received frame."""
    return session.scalar(select(Frame).order_by(Frame.id.desc()).limit(1))


def page(
    session: Session,
    limit: int,
    offset: int,
    *,
    source: str = "",
    outcome: str = "",
    mode: str = "",
    contact_id: int | None = None,
    start: datetime | None = None,
    end: datetime | None = None,
    least_stars: int | None = None,
    most_stars: int | None = None,
) -> tuple[int, list[Frame]]:
    """Return the total number and one page of frames with ``start`` ≤ taken < ``end``, newest first. ``outcome`` and
    star counts refer to the operational ground solution. ``outcome``: solved, none, a verdict (correct, imprecise,
    wrong), or unsolved for frames without this solution."""
    query = select(Frame)
    for column, value in ((Frame.source, source or None), (Frame.mode, mode or None), (Frame.contact_id, contact_id)):
        if value is not None:
            query = query.where(column == value)
    if start is not None:
        query = query.where(Frame.taken >= start)
    if end is not None:
        query = query.where(Frame.taken < end)
    is_operational = (Solution.frame_id == Frame.id) & Solution.operational
    if outcome == "unsolved":
        query = query.where(~select(Solution.id).where(is_operational).exists())
    elif outcome or least_stars is not None or most_stars is not None:
        query = query.join(Solution, is_operational)
        if outcome in ("solved", "none"):
            query = query.where(Solution.outcome == outcome)
        elif outcome:
            query = query.where(Solution.verdict == outcome, Solution.outcome == "solved")
        if least_stars is not None:
            query = query.where(Solution.matched >= least_stars)
        if most_stars is not None:
            query = query.where(Solution.matched <= most_stars)
    total = session.scalar(query.with_only_columns(func.count(Frame.id))) or 0
    rows = session.scalars(query.order_by(Frame.id.desc()).limit(limit).offset(offset))
    return total, list(rows)


def newest_in_slot(session: Session, slot: int, bits: int) -> Frame | None:
    """Return the newest complete image of ``bits`` per pixel that was downloaded from a slot of image memory."""
    query = select(Frame).where(Frame.source == "device", Frame.slot == slot, Frame.complete, Frame.bits == bits)
    query = query.where(Frame.profile.is_not(None), Frame.pixels_removed.is_(None))
    return session.scalar(query.order_by(Frame.id.desc()).limit(1))


def earlier_with_content(session: Session, frame: Frame) -> int | None:
    """Return the id of the first frame with the same pixels that was stored before this one, None if there is none."""
    same = (Frame.sha256 == frame.sha256, Frame.columns == frame.columns, Frame.id < frame.id)
    return session.scalar(select(func.min(Frame.id)).where(*same))


def has_number(session: Session, number: int, start: datetime, end: datetime) -> bool:
    """True if a downloaded frame taken in this time range has that on-board number."""
    query = select(Frame.id).where(Frame.source == "device", Frame.number == number, Frame.taken.between(start, end))
    return session.scalar(query.limit(1)) is not None


def ids_around(session: Session, frame_id: int, each_side: int) -> list[int]:
    """Return the id of a frame and up to ``each_side`` ids before and after it."""
    before = select(Frame.id).where(Frame.id <= frame_id).order_by(Frame.id.desc()).limit(each_side + 1)
    after = select(Frame.id).where(Frame.id > frame_id).order_by(Frame.id).limit(each_side)
    return sorted([*session.scalars(before), *session.scalars(after)])


def ids_of_contact(session: Session, contact_id: int) -> list[int]:
    """Return the ids of the frames of a contact, in ascending order."""
    return list(session.scalars(select(Frame.id).where(Frame.contact_id == contact_id).order_by(Frame.id)))


def ids_solved(session: Session, chain: str, start: datetime, end: datetime, limit: int) -> list[int]:
    """Return the ids of frames that a chain processed on the ground in a time range, in ascending order."""
    solved = select(Solution.frame_id).where(Solution.created >= start, Solution.created <= end)
    return sorted(
        session.scalars(solved.where(Solution.origin == "ground", Solution.chain == chain).distinct().limit(limit))
    )


def existing_ids(session: Session, ids: Sequence[int]) -> list[int]:
    """Return the ids that belong to stored frames, in ascending order."""
    return sorted(session.scalars(select(Frame.id).where(Frame.id.in_(ids))))


def modes(session: Session) -> list[str]:
    """Return the modes of stored frames."""
    return sorted(m for m in session.scalars(select(Frame.mode).distinct()) if m)


def add_solution(session: Session, solution: Solution) -> Solution:
    """Store a solution and assign its id."""
    session.add(solution)
    session.flush()
    return solution


def add_solutions(session: Session, rows: list[dict[str, object]]) -> None:
    """Store many solutions. ``rows``: column values of each solution."""
    session.execute(insert(Solution), rows)


def get_solution(session: Session, solution_id: int) -> Solution:
    """Return the solution with that id. Raises NotFound if it does not exist."""
    row = session.get(Solution, solution_id)
    if row is None:
        raise NotFound("no such solution", got=str(solution_id))
    return row


def solutions_of(session: Session, frame_id: int) -> list[Solution]:
    """Return all solutions of a frame, newest first."""
    return list(session.scalars(select(Solution).where(Solution.frame_id == frame_id).order_by(Solution.id.desc())))


def newest_solution(session: Session, frame_id: int, origin: str) -> Solution | None:
    """Return the newest solution of a frame from that origin."""
    query = select(Solution).where(Solution.frame_id == frame_id, Solution.origin == origin)
    return session.scalar(query.order_by(Solution.id.desc()).limit(1))


def operational_solutions(session: Session, frame_ids: Sequence[int]) -> dict[int, Solution]:
    """Return the operational ground solution of each frame that has one, in one query, without regions and stars."""
    query = select(Solution).where(Solution.frame_id.in_(frame_ids), Solution.operational)
    return {row.frame_id: row for row in session.scalars(query.options(defer(Solution.detail)))}


def attitude_pairs(session: Session, limit: int) -> list[tuple[Frame, Solution, Solution]]:
    """Return up to ``limit`` device frames with an on-board and an operational ground attitude, newest first. Each
    frame is returned with its newest on-board solution and its operational ground solution, without regions and
    stars."""
    on_board, ground = aliased(Solution), aliased(Solution)
    newest_id = (
        select(func.max(Solution.id))
        .where(Solution.frame_id == Frame.id, Solution.origin == "on board", Solution.outcome == "solved")
        .correlate(Frame)
        .scalar_subquery()
    )
    query = (
        select(Frame, on_board, ground)
        .join(on_board, on_board.frame_id == Frame.id)
        .join(ground, ground.frame_id == Frame.id)
        .where(Frame.source == "device", on_board.origin == "on board", ground.operational)
        .where(on_board.outcome == "solved", ground.outcome == "solved")
        .where(on_board.id == newest_id)
        .options(defer(on_board.detail), defer(ground.detail))
        .order_by(Frame.id.desc())
        .limit(limit)
    )
    return [(frame, reported, solved) for frame, reported, solved in session.execute(query)]


def newest_ground_attitude(session: Session) -> tuple[Frame, Solution] | None:
    """Return the newest frame of the device with an operational ground attitude, and that solution without its
    stars."""
    query = (
        select(Frame, Solution)
        .join(Solution, Solution.frame_id == Frame.id)
        .where(Frame.source == "device", Solution.operational, Solution.outcome == "solved")
        .options(defer(Solution.detail))
        .order_by(Frame.id.desc())
        .limit(1)
    )
    row = session.execute(query).first()
    return None if row is None else (row[0], row[1])


def pin_missing(session: Session, frame_ids: Sequence[int], chain: str) -> None:
    """Make the oldest solution of ``chain`` operational for each frame without an operational solution. Only solutions
    with the default constants and the frame's camera are considered. Call this after the rows were added: an SQLite
    transaction that begins with a write excludes other writers."""
    _lock(session, frame_ids)
    other = aliased(Solution)
    # Correlated, because a list of all frames with an operational solution would be read for every batch.
    pinned = exists().where(other.frame_id == Frame.id, other.operational)
    oldest = (
        select(func.min(Solution.id))
        .join(Frame, Frame.id == Solution.frame_id)
        .where(Frame.id.in_(frame_ids), ~pinned)
        .where(Solution.origin == "ground", Solution.replay.is_(None), Solution.chain == chain)
        .where(Solution.camera_name == func.coalesce(Frame.profile, BLIND), Solution.options == "")
        .group_by(Frame.id)
    )
    ids = list(session.scalars(oldest))
    if ids:
        session.execute(update(Solution).where(Solution.id.in_(ids)).values(operational=True))


def pin(session: Session, frame_id: int, solution_id: int) -> None:
    """Make a solution the operational solution of its frame, replacing the previous one."""
    _lock(session, [frame_id])
    of_frame = update(Solution).where(Solution.frame_id == frame_id)
    session.execute(of_frame.where(Solution.operational).values(operational=False))
    session.execute(of_frame.where(Solution.id == solution_id).values(operational=True))


def _lock(session: Session, frame_ids: Sequence[int]) -> None:
    """Wait on PostgreSQL for other transactions that pin solutions of these frames. SQLite has a single writer."""
    if session.get_bind().dialect.name != "sqlite":
        session.execute(select(Frame.id).where(Frame.id.in_(frame_ids)).order_by(Frame.id).with_for_update())


def solved_by(session: Session, chain: str, version: str, options: str) -> set[int]:
    """Return the ids of the frames that this version of a chain has processed on the ground with these changed
    constants."""
    criteria = (Solution.chain == chain, Solution.version == version, Solution.options == options)
    query = select(Solution.frame_id).where(Solution.origin == "ground", Solution.replay.is_(None), *criteria)
    return set(session.scalars(query.distinct()))


class SolutionOutcome(NamedTuple):
    """Columns of a solution needed for comparisons, without its overlays."""

    frame_id: int
    chain: str
    version: str
    options: str
    outcome: str
    verdict: str | None
    error_axis_rad: float | None
    rms_px: float | None
    timing_s: dict[str, float]


def newest_by_chain(session: Session) -> list[SolutionOutcome]:
    """Return the newest ground result of each frame, chain, version and set of changed constants."""
    newest = (
        select(func.max(Solution.id))
        .where(Solution.origin == "ground", Solution.replay.is_(None))
        .group_by(Solution.frame_id, Solution.chain, Solution.version, Solution.options)
    )
    columns = [getattr(Solution, name) for name in SolutionOutcome._fields]
    return [SolutionOutcome(*row) for row in session.execute(select(*columns).where(Solution.id.in_(newest)))]


class ChainKey(NamedTuple):
    """A chain, its version and its changed constants (NAME=VALUE, …; empty: none)."""

    chain: str
    version: str
    options: str


class FrameRun(NamedTuple):
    """Columns of a frame and of one of its solutions, without overlays."""

    frame_id: int
    taken: datetime
    outcome: str
    reason: str
    verdict: str | None
    quaternion: list[Any] | None
    error_axis_rad: float | None
    rms_px: float | None
    timing_s: dict[str, float]

    @property
    def solved(self) -> bool:
        """True if the solution has an attitude."""
        return self.outcome == "solved" and self.quaternion is not None


def _runs(session: Session, ids: Any) -> list[FrameRun]:
    """Return the solutions whose ids the query selects, sorted by the time of their frames."""
    columns = [getattr(Solution, name) for name in FrameRun._fields if name != "taken"]
    query = select(columns[0], Frame.taken, *columns[1:]).join(Frame, Frame.id == Solution.frame_id)
    return [
        FrameRun(*row) for row in session.execute(query.where(Solution.id.in_(ids)).order_by(Frame.taken, Frame.id))
    ]


def runs_of(session: Session, key: ChainKey, limit: int) -> list[FrameRun]:
    """Return the newest result of a chain for each of the ``limit`` newest frames that it processed, oldest frame
    first."""
    criteria = (Solution.chain == key.chain, Solution.version == key.version, Solution.options == key.options)
    newest = (
        select(func.max(Solution.id))
        .where(Solution.origin == "ground", Solution.replay.is_(None), *criteria)
        .group_by(Solution.frame_id)
        .order_by(Solution.frame_id.desc())
        .limit(limit)
    )
    return _runs(session, newest)


def operational_runs(session: Session, frame_ids: Sequence[int]) -> list[FrameRun]:
    """Return the operational solutions of frames, oldest frame first."""
    last_id = max(frame_ids, default=0)
    first_id = min(frame_ids, default=0)
    return _runs(session, select(Solution.id).where(Solution.operational, Solution.frame_id.between(first_id, last_id)))


def results(session: Session, chain: str = "") -> list[tuple[Frame, Solution]]:
    """Return frames with their solutions, oldest solution first, without overlays."""
    query = select(Frame, Solution).join(Solution, Solution.frame_id == Frame.id).options(defer(Solution.detail))
    if chain:
        query = query.where(Solution.chain == chain)
    return [(frame, solution) for frame, solution in session.execute(query.order_by(Solution.id))]
