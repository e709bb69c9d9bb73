"""Command authority: taking, releasing and breaking it, and the records of these."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import pytest

from gss.domain.errors import BadInput, Conflict
from gss.operations.commanding.authority import AuthorityService


@pytest.fixture
def authority(database, bus, clock) -> AuthorityService:
    """Authority service with an empty database."""
    return AuthorityService(database, bus, clock)


def texts(bus) -> list[str]:
    return [event.text for event in bus.after(0, 100)]


def test_one_holder_at_a_time(authority, clock):
    """Another user is rejected with the holder's name, and can take the authority after it is released."""
    assert authority.state().holder is None
    assert authority.take("ann").holder.holder == "ann"
    with pytest.raises(Conflict, match="held by ann") as caught:
        authority.take("bob")
    assert str(caught.value).count("ann") == 1
    with pytest.raises(Conflict, match="held by ann"):
        authority.check("bob")
    authority.check("ann")
    clock.forward(10)
    assert authority.release("ann").holder is None
    state = authority.take("bob")
    assert [(row.holder, row.ended is None) for row in state.history] == [("bob", True), ("ann", False)]
    assert (state.history[1].ended - state.history[1].taken).total_seconds() == 10


def test_taking_twice_is_recorded_once(authority, bus):
    """Taking authority that the user already holds adds no record."""
    authority.take("ann")
    assert len(authority.take("ann").history) == 1
    assert texts(bus) == ["ann took command authority"]


def test_the_first_command_takes_authority(authority, bus):
    """The first command takes the authority if no user holds it, and the event states this."""
    authority.require("ann")
    authority.require("ann")
    assert authority.holder() == "ann"
    assert texts(bus) == ["ann took command authority with the first command"]
    with pytest.raises(Conflict, match="held by ann"):
        authority.require("bob")


def test_breaking_needs_a_reason_and_another_holder(authority, bus):
    """Breaking needs a reason, which is stored with the ended row and in a warning. Only authority
    of another user can be broken."""
    with pytest.raises(Conflict, match="no other user"):
        authority.break_("bob", "pass begins")
    authority.take("ann")
    with pytest.raises(Conflict, match="no other user"):
        authority.break_("ann", "pass begins")
    for invalid_reason in ("", "  \n ", "x" * 301):
        with pytest.raises(BadInput, match="needs a reason"):
            authority.break_("bob", invalid_reason)
    assert authority.holder() == "ann"
    state = authority.break_("bob", " ann left \n her desk ")
    assert (state.holder.holder, state.history[1].ended_by, state.history[1].reason) == (
        "bob",
        "bob",
        "ann left her desk",
    )
    event = bus.after(0, 100)[-1]
    assert (event.kind, event.severity) == ("authority", "warning")
    assert "broke the command authority of ann: ann left her desk" in event.text


def test_only_the_holder_releases(authority):
    """Only the holder can release the authority."""
    with pytest.raises(Conflict, match="only the holder"):
        authority.release("ann")
    authority.take("ann")
    with pytest.raises(Conflict) as caught:
        authority.release("bob")
    assert str(caught.value).count("ann") == 1


def test_of_simultaneous_first_commands_one_takes_authority(authority):
    """If several users send a first command simultaneously, exactly one takes the authority and the others are rejected."""

    def try_command(user: str) -> bool:
        try:
            authority.require(user)
        except Conflict:
            return False
        return True

    with ThreadPoolExecutor(8) as pool:
        results = list(pool.map(try_command, [f"user-{k}" for k in range(8)]))
    assert results.count(True) == 1
    assert authority.holder() == f"user-{results.index(True)}"


def test_authority_survives_a_restart(authority, database, bus, clock):
    """After a restart the holder is the same."""
    authority.take("ann")
    assert AuthorityService(database, bus, clock).holder() == "ann"


@pytest.mark.parametrize("name", ["", " ann", "a\nb", "x" * 61])
def test_unprintable_names_cannot_hold_authority(authority, name):
    """An unprintable user name is rejected, because names are shown in the header bar and in exports."""
    with pytest.raises(BadInput, match="user name is not valid"):
        authority.take(name)
    assert authority.holder() is None


def test_every_change_is_published(authority, bus):
    """Every change is published on the topic "authority" with the complete state."""
    subscription = bus.subscribe(lambda: None)
    authority.take("ann")
    authority.release("ann")
    published = [m.payload for m in subscription.take()[0] if m.topic == "authority"]
    assert [state.holder.holder if state.holder else None for state in published] == ["ann", None]
