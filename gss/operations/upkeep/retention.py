"""Retention: removes old data in a defined order. Rows of frames, their solutions, commands, alarms, contacts and the
audit log are always kept. Pixels, telemetry packets, old events and the oldest raw captures can be removed.

Nothing is removed until a user has set a policy. A removal runs as a job in small transactions, so that the line never
waits for it. After a crash it continues from its checkpoint. It does not run while the server's clock is in doubt, and
needs confirmation if it would remove an unusual share of the stored data.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import Any

from gss.domain.errors import Conflict
from gss.operations.clock import Now
from gss.operations.events import EventBus
from gss.operations.folder_lock import named_lock
from gss.operations.jobs import JobKind, JobResult, JobRun, JobService
from gss.operations.line.capture_files import SizedFile, capture_sizes
from gss.operations.line.link import LinkService
from gss.operations.upkeep.clock_trust import ClockTrust
from gss.operations.upkeep.removal import ConfirmedRemoval, Removal, check_confirmed, check_fresh, recent, unusual
from gss.operations.upkeep.retention_policy import (
    CHOICE,
    DAY,
    RemovalJob,
    RetentionPolicy,
    retention_choice,
    stored_policy,
    unconfirmed,
)
from gss.store import choices, frames
from gss.store import upkeep as store
from gss.store.blobs import BlobStore
from gss.store.engine import Database
from gss.store.models import Frame, Job

DONE, WAITING = "retention.done", "retention.waiting"
FRAMES_AT_ONCE = 200
THIN_EVERY_S = 60.0
FIGURES = ("frames", "bytes", "packets", "thinned", "events")


class RetentionService:
    """Stores the policy, and previews and runs removals. ``share``: removing a larger share of a kind of data needs
    confirmation."""

    def __init__(
        self,
        database: Database,
        blobs: BlobStore,
        jobs: JobService,
        bus: EventBus,
        link: LinkService,
        lock: Path,
        now: Now,
        trust: ClockTrust,
        share: float,
    ) -> None:
        self._trust, self._share = trust, share
        self._database, self._blobs, self._jobs, self._bus = database, blobs, jobs, bus
        self._link, self._lock, self._now = link, lock, now
        self._default_capture_bytes = self.capture_bytes()
        self.now = now
        jobs.register(JobKind("retention", RemovalJob, self.work, renewed=self._renewed, repeated=unconfirmed))

    def start(self) -> None:
        """Apply the policy to the raw captures."""
        self._limit_captures(self.policy())

    def _limit_captures(self, policy: RetentionPolicy) -> None:
        self._link.capture.keep_at_most((policy.captures_mb << 20) or self._default_capture_bytes)

    def policy(self) -> RetentionPolicy:
        """Return the active policy."""
        return stored_policy(self._database)

    def choose(self, policy: RetentionPolicy, *, user: str) -> RetentionPolicy:
        """Set another policy. It applies from the next run on; the limit for raw captures applies immediately."""
        with self._database.unit_of_work() as session:
            choices.write(session, CHOICE, policy.model_dump(), self._now(), user)
            choices.forget(session, WAITING)
        self._limit_captures(policy)
        rules = ", ".join(f"{k} {v:g}" for k, v in policy.model_dump().items() if v)
        self._bus.record("upkeep", "watch", f"Retention changed by {user}: {rules or 'keep everything'}")
        return policy

    def favourite(self, frame_id: int, favourite: bool) -> Frame:
        """Mark a frame as favourite, or unmark it. Pixels of a favourite are never removed. Raises NotFound."""
        with self._database.unit_of_work() as session:
            frames.get(session, frame_id)
            store.set_favourite(session, frame_id, favourite)
        with self._database.unit_of_work() as session:
            return frames.get(session, frame_id)

    def run(self, *, user: str, confirmed: ConfirmedRemoval | None = None) -> Job:
        """Start a removal as a job. Raises Conflict if the clock is in doubt, or if the removal is unusual and not
        confirmed."""
        self._trust.require("retention")
        if confirmed is not None:
            check_fresh(confirmed, self._now())
        check_confirmed(self.preview(self.policy(), confirmed.at if confirmed else None), confirmed, self._share)
        return self._begin(user, confirmed)

    def run_daily(self) -> Job:
        """Start a removal without confirmation. The job checks whether the removal is unusual."""
        return self._begin("gss, daily", None)

    def _begin(self, user: str, confirmed: ConfirmedRemoval | None) -> Job:
        return self._jobs.begin("retention", "retention", RemovalJob(self.policy(), confirmed, user=user))

    def _renewed(self, request: RemovalJob) -> RemovalJob:
        """Return the request with the active policy, because a withdrawn policy must not remove anything."""
        return replace(request, policy=self.policy())

    def waiting(self) -> str:
        """Return why the last removal waits for confirmation; "" if it does not wait."""
        return str(retention_choice(self._database, WAITING).get("text", ""))

    def capture_sizes(self) -> list[SizedFile]:
        """Return the files of the raw captures with their sizes, oldest first."""
        return capture_sizes(self._link.capture.folder)

    def capture_bytes(self) -> int:
        """Return the maximum total size of the raw captures in bytes."""
        return self._link.capture.retention.keep_bytes

    def preview(self, policy: RetentionPolicy, at: datetime | None = None) -> Removal:
        """Return the amounts that a removal with ``policy`` would remove, as of ``at`` (default: now). Nothing is
        removed."""
        at = at or self._now()
        thinned_text = retention_choice(self._database, DONE).get("thinned_before")
        thinned = datetime.fromisoformat(thinned_text) if thinned_text else None
        removable = list(self.going(policy, at))
        packets, thin_before, events = (
            _cutoff(at, days) for days in (policy.telemetry_days, policy.telemetry_thin_days, policy.events_days)
        )
        with self._database.unit_of_work() as session:
            since = max((m for m in (thinned, packets) if m), default=None)
            removal = Removal(
                at=at,
                frames=len(removable),
                frames_bytes=sum(p.size for p in removable),
                packets=store.count_packets(session, packets) if packets else 0,
                to_thin=store.count_packets(session, thin_before, since) if thin_before else 0,
                events=store.count_events(session, events) if events else 0,
            )
            amounts = store.amounts(session, recent(self.last_run(), at))
        return replace(removal, unusual=unusual(removal, amounts, self._share))

    def last_run(self) -> datetime | None:
        """Return the time of the last removal; None if there was none."""
        at = retention_choice(self._database, DONE).get("at")
        return datetime.fromisoformat(at) if at else None

    def removed_before(self) -> datetime | None:
        """Return the time before which gaps in housekeeping can be caused by retention; None if retention has not
        removed or thinned packets."""
        choice = retention_choice(self._database, DONE)
        moments = [datetime.fromisoformat(choice[k]) for k in ("packets_before", "thinned_before") if choice.get(k)]
        return max(moments, default=None)

    # --- removal ------------------------------------------------------------------------------------------------

    def work(self, request: RemovalJob, run: JobRun) -> JobResult:
        """Run a removal. The lock prevents a concurrent backup, which needs the blobs that its rows reference."""
        with named_lock(self._lock, "", wait=True):
            return self._remove(request, run)

    def _remove(self, request: RemovalJob, run: JobRun) -> JobResult:
        """Remove data in steps. The checkpoint contains the removed amounts, and the blobs that must still be deleted
        because their rows are already marked."""
        self._trust.require("retention")
        policy, confirmed = request.policy, request.confirmed
        progress = run.checkpoint or {"at": (confirmed.at if confirmed else self._now()).isoformat(), "pending": []}
        at = datetime.fromisoformat(progress["at"])
        self._check(policy, at, confirmed)
        removed: dict[str, int] = dict(progress.get("removed") or dict.fromkeys(FIGURES, 0))
        self._delete_blobs(progress["pending"], removed)
        self._remove_pixels(policy, at, removed, run)
        packets, thinned = _cutoff(at, policy.telemetry_days), _cutoff(at, policy.telemetry_thin_days)
        with self._database.unit_of_work() as session:
            kinds = store.packet_kinds(session)
        for kind in kinds:
            if packets is not None:
                self._batches(run, removed, "packets", at, partial(_remove_packets, kind, packets))
            if thinned is not None:
                self._thin(run, removed, kind, at, thinned)
        events = _cutoff(at, policy.events_days)
        if events is not None:
            self._batches(run, removed, "events", at, partial(_remove_events, events))
        self._store_run(at, packets, thinned)
        if any(removed.values()):
            packets_gone = removed["packets"] + removed["thinned"]
            amount = f"pixels of {removed['frames']} frames, {packets_gone} packets, {removed['events']} events"
            self._bus.record("upkeep", "ok", f"Retention removed {amount}", **removed)
        return {"removed": removed}

    def _check(self, policy: RetentionPolicy, at: datetime, confirmed: ConfirmedRemoval | None) -> None:
        """Raise Conflict if a user must confirm the removal first, and store the reason for the page and the alarm."""
        removal = self.preview(policy, at)
        try:
            check_confirmed(removal, confirmed, self._share)
        except Conflict:
            with self._database.unit_of_work() as session:
                choices.write(session, WAITING, {"text": removal.unusual}, self._now(), "gss")
            raise

    def _remove_pixels(self, policy: RetentionPolicy, at: datetime, removed: dict[str, int], run: JobRun) -> None:
        removable = list(self.going(policy, at))
        for group in _groups(removable):
            run.progress(removed["frames"], len(removable), f"Pixels of {removed['frames']} of {len(removable)} frames")
            with self._database.unit_of_work() as session:
                changed = store.remove_pixels(session, [p.frame_id for p in group], at)
                keys = sorted({p.sha256 for p in group if p.frame_id in changed})
                removed["frames"] += len(changed)
                # Rows are changed before blobs are deleted. A crash can therefore leave an unused blob, but never a row
                # whose blob is missing.
                run.keep({"at": at.isoformat(), "pending": keys, "removed": removed}, session)
            self._delete_blobs(keys, removed)

    def going(self, policy: RetentionPolicy, at: datetime) -> Iterator[store.Pixels]:
        """Yield the pixels that the policy removes, oldest first."""
        if not policy.frames_days and not policy.frames_gb:
            return
        with self._database.unit_of_work() as session:
            total = store.pixel_bytes(session)[1]
        oldest_kept = _cutoff(at, policy.frames_days)
        for pixels in self.unprotected(policy):
            too_many = bool(policy.frames_gb) and total > policy.frames_gb * 1e9
            if too_many or (oldest_kept is not None and pixels.received < oldest_kept):
                total -= pixels.size
                yield pixels

    def unprotected(self, policy: RetentionPolicy) -> list[store.Pixels]:
        """Return the pixels that the policy removes at some age or total size, oldest first: not those of favourites, of
        frames used by studies and of the latest frames."""
        with self._database.unit_of_work() as session:
            used_ids = store.used_by_studies(session)
            stored_pixels = list(store.pixels_held(session))
        older = stored_pixels[: max(0, len(stored_pixels) - policy.keep_frames)]
        return [pixels for pixels in older if pixels.frame_id not in used_ids]

    def _delete_blobs(self, keys: list[str], removed: dict[str, int]) -> None:
        """Delete the blobs that no row references."""
        with self._database.unit_of_work() as session:
            needed = store.still_needed(session, keys)
        for key in keys:
            if key not in needed and self._blobs.exists(key):
                removed["bytes"] += self._blobs.size(key)
                self._blobs.delete(key)

    def _batches(
        self, run: JobRun, removed: dict[str, int], name: str, at: datetime, remove: Callable[[Any], int]
    ) -> None:
        while True:
            run.progress(removed[name], 0, f"{name}: {removed[name]} removed")
            with self._database.unit_of_work() as session:
                batch_size = remove(session)
                removed[name] += batch_size
                run.keep({"at": at.isoformat(), "pending": [], "removed": removed}, session)
            if not batch_size:
                return

    def _thin(self, run: JobRun, removed: dict[str, int], kind: str, at: datetime, before: datetime) -> None:
        reached = None
        while True:
            run.progress(removed["thinned"], 0, f"Thinning {kind}: {removed['thinned']} removed")
            with self._database.unit_of_work() as session:
                thinned, reached = store.thin_packets(session, kind, reached, before, THIN_EVERY_S)
                removed["thinned"] += thinned
                run.keep({"at": at.isoformat(), "pending": [], "removed": removed}, session)
            if reached is None:
                return

    def _store_run(self, at: datetime, packets: datetime | None, thinned: datetime | None) -> None:
        previous = retention_choice(self._database, DONE)
        value = previous | {"at": at.isoformat()}
        for name, moment in (("packets_before", packets), ("thinned_before", thinned)):
            if moment is not None:
                value[name] = max(previous.get(name) or "", moment.isoformat())
        with self._database.unit_of_work() as session:
            choices.write(session, DONE, value, self._now(), "gss")
            choices.forget(session, WAITING)


def _remove_packets(kind: str, before: datetime, session: Any) -> int:
    return store.remove_packets(session, kind, before)


def _remove_events(before: datetime, session: Any) -> int:
    return store.remove_events(session, before)


def _cutoff(at: datetime, days: float) -> datetime | None:
    return at - days * DAY if days else None


def _groups(items: list[store.Pixels]) -> Iterator[tuple[store.Pixels, ...]]:
    for k in range(0, len(items), FRAMES_AT_ONCE):
        yield tuple(items[k : k + FRAMES_AT_ONCE])
