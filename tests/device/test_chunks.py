"""Chunk sets, sender and receiver, tested without line or session."""

from __future__ import annotations

import numpy as np
import pytest

from gss.device.protocol.transfer import ChunkReceiver, ChunkSender, ChunkSet, chunk_count


def test_chunk_sets_count_ranges_and_bytes() -> None:
    """Ranges are inclusive, pages are bounded, and the last chunk may be shorter."""
    held = ChunkSet(10, [0, 1, 4, 9])
    assert held.ranges() == (((0, 1), (4, 4), (9, 9)), 10)
    assert held.ranges(0, 2) == (((0, 1), (4, 4)), 9)
    assert held.ranges(5, 2) == (((9, 9),), 10)
    assert held.first_missing == 2
    assert held.stored_bytes(95, 10) == 35
    held.add_range(2, 100)
    assert held.complete
    assert held.first_missing == 10
    assert not held.add(3)
    assert not held.add(10)
    assert (chunk_count(95, 10), chunk_count(100, 10), chunk_count(0, 10)) == (10, 10, 0)


@pytest.mark.parametrize("loss", [0.0, 0.3, 0.7])
def test_sender_and_receiver_finish_despite_losses(loss: float) -> None:
    """With random loss of chunks, status pages and requests, every chunk arrives and the window is never exceeded.
    Without loss, no chunk is sent twice."""
    rng = np.random.default_rng(5)
    sender, receiver = ChunkSender(300, 16, 0.5), ChunkReceiver(3000, 10, 16)
    sent, now_s = 0, 0.0
    for _ in range(200_000):
        now_s += 0.02
        choice = sender.next_chunk(now_s)
        if choice is not None:
            sent += 1
            if rng.random() >= loss:
                receiver.accept(choice[0], choice[1], 10)
        assert sender.in_flight <= 16
        pages = [receiver.status()] if receiver.status_due() else []
        due = sender.request_due(now_s)
        if due is not None and rng.random() >= loss:
            pages.append(receiver.status(due[1], due[0]))
        for page in pages:
            assert len(page.ranges) <= 16
            if rng.random() >= loss:
                sender.on_status(page, now_s)
        if sender.complete:
            break
    assert receiver.stored.complete
    assert sender.complete
    if loss == 0:
        assert sent == 300
    assert receiver.requested_again == sender.resent == sent - 300


def test_a_resumed_sender_reads_all_pages_first() -> None:
    """If every second chunk is held, which needs several status pages, only the missing chunks are sent."""
    receiver = ChunkReceiver(2000, 10, 16, range(0, 200, 2))
    sender, sent, now_s = ChunkSender(200, 16, 0.5, resumed=True), [], 0.0
    while not sender.complete and now_s < 100:
        now_s += 0.02
        due = sender.request_due(now_s)
        if due is not None:
            sender.on_status(receiver.status(due[1], due[0]), now_s)
        choice = sender.next_chunk(now_s)
        if choice is not None:
            sent.append(choice[0])
            receiver.accept(choice[0], choice[1], 10)
        if receiver.status_due():
            sender.on_status(receiver.status(), now_s)
    assert sorted(sent) == list(range(1, 200, 2))
