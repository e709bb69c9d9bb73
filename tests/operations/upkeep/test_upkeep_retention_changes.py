"""Retention follows changes of frames and of its policy during a removal; the forecast ignores frames that are kept."""

from __future__ import annotations

from datetime import timedelta

import pytest
from sqlalchemy import select

from gss.operations.upkeep import retention as room
from gss.operations.upkeep.forecast import ForecastService
from gss.operations.upkeep.retention_policy import RetentionPolicy
from gss.store.models import Calibration, Frame


@pytest.mark.parametrize("protection", ["favourite", "study"])
def test_a_frame_that_is_protected_during_a_removal_keeps_its_pixels(store, monkeypatch, protection):
    """A frame that becomes a favourite or is used by a calibration while the removal runs keeps its pixels and is not
    counted as removed."""
    monkeypatch.setattr(room, "FRAMES_AT_ONCE", 2)
    ids = [store.add_frame(bytes([k]) * 500, age_days=30 - k) for k in range(6)]
    store.retention.choose(RetentionPolicy(frames_days=10, keep_frames=0), user="ann")
    delete, calls = store.retention._delete_blobs, []

    def delete_and_protect(keys, removed):
        delete(keys, removed)
        calls.append(keys)
        if len(calls) != 2:  # the first group of frames is removed at the second call
            return
        if protection == "favourite":
            store.retention.favourite(ids[-1], True)
        else:
            made = {"created": store.clock(), "author": "a", "tool": "t", "values": {}, "result": {}}
            with store.database.unit_of_work() as session:
                session.add(Calibration(profile="p", kind="dark", name="n", request={"dark_ids": [ids[-1]]}, **made))

    monkeypatch.setattr(store.retention, "_delete_blobs", delete_and_protect)
    removed = store.end(store.retention.run(user="ann")).result["removed"]
    with store.database.unit_of_work() as session:
        left = list(session.scalars(select(Frame.id).where(Frame.pixels_removed.is_(None))))
    assert (left, removed["frames"]) == ([ids[-1]], 5)
    assert store.blob_path(bytes([5]) * 500).exists()


def test_the_default_limit_of_captures_applies_again_without_a_restart(store):
    """If the limit of captures is set to 0, the configured limit applies, immediately and after a restart."""
    default = store.retention.capture_bytes()
    store.retention.choose(RetentionPolicy(captures_mb=100), user="ann")
    assert store.retention.capture_bytes() == 100 << 20
    store.retention.choose(RetentionPolicy(), user="ann")
    assert store.retention.capture_bytes() == default
    store.retention.start()
    assert store.retention.capture_bytes() == default


def test_the_forecast_ignores_frames_that_are_kept(store):
    """The next removal depends on the oldest frame whose pixels are not kept; without such frames there is none."""
    ids = [store.add_frame(bytes([k]) * 500, age_days=days) for k, days in enumerate((40, 4, 2))]
    forecast = ForecastService(store.database, store.retention, store.disk, store.backups.folder)
    store.retention.favourite(ids[0], True)
    store.retention.choose(RetentionPolicy(frames_days=10, keep_frames=1), user="ann")
    assert forecast.now().next_removal == store.clock() + timedelta(days=6)
    store.retention.choose(RetentionPolicy(frames_days=10, keep_frames=100), user="ann")
    assert (forecast.now().next_removal, forecast.now().removable_bytes) == (None, 0)
