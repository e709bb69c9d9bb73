"""Tokens of programs, and what each role may."""

from __future__ import annotations

import pytest

from gss.device.dictionary_file import load_dictionary
from gss.domain.errors import BadInput, Conflict, NotPermitted, TooOften
from gss.operations.accounts.accounts import AccountService
from gss.operations.accounts.attempts import BY_TOKEN_ADDRESS
from gss.operations.accounts.passwords import Passwords
from gss.operations.accounts.permissions import ALL, COMMANDS, ROLES, permitted, require
from gss.store.models import ApiToken


@pytest.fixture
def accounts(database, clock) -> AccountService:
    """With one admin, ann."""
    service = AccountService(database, clock, lambda: clock.at.timestamp(), Passwords(1, 8, 1))
    service.users.add("ann", "admin", by="shell")
    return service


def test_a_token_is_known_by_its_hash_until_its_end(accounts, database, clock):
    """It acts under its own name and role; the key is told once and stored nowhere."""
    made = accounts.tokens.add("night run", "engineer", 7, by="ann")
    who = accounts.who_has_token(made.key, "a")
    assert (who.name, who.may("campaigns"), who.may("link.open")) == ("token:night run", True, False)
    assert made.key.startswith("gss_")
    with database.unit_of_work() as session:
        assert all(made.key not in str(vars(row)) for row in session.query(ApiToken))
    clock.forward(7 * 86400)
    assert accounts.who_has_token(made.key, "a") is None
    assert "over" in accounts.why_over(who)


def test_scopes_narrow_a_token_and_never_widen_it(accounts):
    """Only permissions of the role can be asked for."""
    made = accounts.tokens.add("metrics", "viewer", 1, by="ann", scopes=["metrics"])
    who = accounts.who_has_token(made.key, "a")
    assert who.permissions == {"metrics"}
    with pytest.raises(BadInput, match="not all"):
        accounts.tokens.add("more", "viewer", 1, by="ann", scopes=["admin.users"])


def test_a_revoked_token_is_worth_nothing_at_once(accounts):
    """So is one whose maker was switched off or is no admin any more."""
    made = accounts.tokens.add("t", "operator", 1, by="ann")
    assert accounts.who_has_token(made.key, "a") is not None
    accounts.require("token:t", "command.link")
    accounts.tokens.revoke(made.row.id)
    assert accounts.who_has_token(made.key, "a") is None
    with pytest.raises(NotPermitted):
        accounts.require("token:t", "command.link")
    eve = accounts.users.add("eve", "admin", by="ann")
    hers = accounts.tokens.add("hers", "admin", 1, by="eve", owner_id=eve.id)
    assert accounts.who_has_token(hers.key, "a") is not None
    accounts.users.change(eve.id, enabled=False)
    assert accounts.who_has_token(hers.key, "a") is None
    accounts.users.change(eve.id, enabled=True)
    assert accounts.who_has_token(hers.key, "a") is not None
    accounts.users.change(eve.id, role="viewer")
    assert accounts.who_has_token(hers.key, "a") is None


def test_with_a_token_those_that_it_made_are_revoked(accounts, clock):
    """And what they made; not those of people, of other tokens, or of the next one that has the name."""
    people = accounts.tokens.add("people", "viewer", 9, by="ann")
    parent = accounts.tokens.add("parent", "admin", 9, by="shell:root")
    clock.forward(60)
    child = accounts.tokens.add("child", "admin", 8, by="token:parent")
    grandchild = accounts.tokens.add("grandchild", "viewer", 7, by="token:child")
    again = accounts.tokens.add("again", "viewer", 7, by="token:parents")
    accounts.tokens.revoke_named("parent")
    assert [accounts.who_has_token(made.key, "a") for made in (parent, child, grandchild)] == [None] * 3
    assert all(accounts.who_has_token(made.key, "a") for made in (people, again))
    clock.forward(60)
    second = accounts.tokens.add("parent", "admin", 9, by="ann")
    hers = accounts.tokens.add("hers", "viewer", 8, by="token:parent")
    accounts.tokens.revoke(parent.row.id)
    assert all(accounts.who_has_token(made.key, "a") for made in (second, hers))


def test_two_living_tokens_have_two_names(accounts):
    """A name on the record must mean one key; after revoking it is free again."""
    first = accounts.tokens.add("t", "viewer", 1, by="ann")
    with pytest.raises(Conflict):
        accounts.tokens.add("t", "admin", 1, by="ann")
    accounts.tokens.revoke(first.row.id)
    assert accounts.tokens.add("t", "viewer", 1, by="ann").row.id != first.row.id


def test_guessing_tokens_is_braked_and_the_right_one_still_works(accounts):
    """Bad tokens make their address wait; whoever has a good one is not held up."""
    made = accounts.tokens.add("t", "viewer", 1, by="ann")
    for number in range(BY_TOKEN_ADDRESS.free):
        assert accounts.who_has_token(f"gss_{number}", "a") is None
    with pytest.raises(TooOften):
        accounts.who_has_token("gss_one_more", "a")
    assert accounts.who_has_token(made.key, "a") is not None


@pytest.mark.parametrize(
    ("name", "days"), [("", 1), ("x" * 51, 1), ("a\nb", 1), ("t", 0), ("t", 400), ("t", float("nan"))]
)
def test_a_token_has_a_name_and_an_end(accounts, name, days):
    """Nothing endless, nothing that cannot be shown."""
    with pytest.raises(BadInput):
        accounts.tokens.add(name, "viewer", days, by="ann")


def test_roles_stand_side_by_side(accounts):
    """Viewer is in all, admin has all; operator, manager and engineer each have something the others lack."""
    assert all(ROLES["viewer"] <= role for role in ROLES.values())
    assert ROLES["admin"] == ALL
    middle = [ROLES[name] for name in ("operator", "catalogue manager", "engineer")]
    assert all(one - other for one in middle for other in middle if one is not other)
    assert not any(p.startswith("admin.") for role in middle for p in role)


def test_there_is_a_permission_for_each_group_of_the_dictionary():
    """No command is outside the table."""
    assert {f"command.{c.subsystem}" for c in load_dictionary().commands} <= set(COMMANDS)


def test_a_refusal_says_who_could():
    """An operator knows whom to ask."""
    with pytest.raises(NotPermitted) as caught:
        require(ROLES["viewer"], "catalogues.build", "viewer")
    assert "catalogues.build" in caught.value.message
    assert caught.value.expected == "the role catalogue manager or admin"
    assert permitted(ROLES["engineer"], "command")
    assert not permitted(ROLES["viewer"], "command")
