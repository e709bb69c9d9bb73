"""Tokens of programs, and the permissions of each role."""

from __future__ import annotations

import pytest

from gss.domain.errors import BadInput, Conflict, NotPermitted, RateLimited
from gss.instruments.dictionary.read_dictionary import load_dictionary
from gss.operations.accounts.accounts import AccountService
from gss.operations.accounts.attempts import BY_TOKEN_ADDRESS
from gss.operations.accounts.passwords import Passwords
from gss.operations.accounts.permissions import ALL, COMMANDS, ROLES, permitted, require
from gss.store.models import ApiToken


@pytest.fixture
def accounts(database, clock) -> AccountService:
    """Account service with one admin, ann."""
    service = AccountService(database, clock, lambda: clock.at.timestamp(), Passwords(1, 8, 1))
    service.users.add("ann", "admin", by="shell")
    return service


def test_a_token_is_found_by_its_hash_until_it_expires(accounts, database, clock):
    """A token has its name and role until it expires. Its key is not stored."""
    made = accounts.tokens.add("night run", "engineer", 7, by="ann")
    who = accounts.token_caller(made.key, "a")
    assert (who.name, who.may("campaigns"), who.may("link.open")) == ("token:night run", True, False)
    assert made.key.startswith("gss_")
    with database.unit_of_work() as session:
        assert all(made.key not in str(vars(row)) for row in session.query(ApiToken))
    clock.forward(7 * 86400)
    assert accounts.token_caller(made.key, "a") is None
    assert "expired" in accounts.ended_reason(who)


def test_scopes_narrow_a_token_and_never_widen_it(accounts):
    """Scopes restrict a token to these permissions. A scope outside the role is rejected."""
    made = accounts.tokens.add("metrics", "viewer", 1, by="ann", scopes=["metrics"])
    who = accounts.token_caller(made.key, "a")
    assert who.permissions == {"metrics"}
    with pytest.raises(BadInput, match="does not have all"):
        accounts.tokens.add("more", "viewer", 1, by="ann", scopes=["admin.users"])


def test_a_revoked_token_is_rejected_immediately(accounts):
    """A revoked token is rejected, and so is a token whose creator is disabled or no longer an admin."""
    made = accounts.tokens.add("t", "operator", 1, by="ann")
    assert accounts.token_caller(made.key, "a") is not None
    accounts.require("token:t", "command.link")
    accounts.tokens.revoke(made.row.id)
    assert accounts.token_caller(made.key, "a") is None
    with pytest.raises(NotPermitted):
        accounts.require("token:t", "command.link")
    eve = accounts.users.add("eve", "admin", by="ann")
    eves_token = accounts.tokens.add("hers", "admin", 1, by="eve", owner_id=eve.id)
    assert accounts.token_caller(eves_token.key, "a") is not None
    accounts.users.change(eve.id, enabled=False)
    assert accounts.token_caller(eves_token.key, "a") is None
    accounts.users.change(eve.id, enabled=True)
    assert accounts.token_caller(eves_token.key, "a") is not None
    accounts.users.change(eve.id, role="viewer")
    assert accounts.token_caller(eves_token.key, "a") is None


def test_revoking_a_token_revokes_the_tokens_it_created(accounts, clock):
    """Revoking a token also revokes indirectly created tokens, but not those created by users, by other tokens, or by a
    later token with the same name."""
    people = accounts.tokens.add("people", "viewer", 9, by="ann")
    parent = accounts.tokens.add("parent", "admin", 9, by="shell:root")
    clock.forward(60)
    child = accounts.tokens.add("child", "admin", 8, by="token:parent")
    grandchild = accounts.tokens.add("grandchild", "viewer", 7, by="token:child")
    similar_creator = accounts.tokens.add("again", "viewer", 7, by="token:parents")
    accounts.tokens.revoke_named("parent")
    assert [accounts.token_caller(made.key, "a") for made in (parent, child, grandchild)] == [None] * 3
    assert all(accounts.token_caller(made.key, "a") for made in (people, similar_creator))
    clock.forward(60)
    second = accounts.tokens.add("parent", "admin", 9, by="ann")
    eves_token = accounts.tokens.add("hers", "viewer", 8, by="token:parent")
    accounts.tokens.revoke(parent.row.id)
    assert all(accounts.token_caller(made.key, "a") for made in (second, eves_token))


def test_active_tokens_have_different_names(accounts):
    """An active token's name cannot be used again, because a name in the audit log must identify one key. After revocation
    it can."""
    first = accounts.tokens.add("t", "viewer", 1, by="ann")
    with pytest.raises(Conflict):
        accounts.tokens.add("t", "admin", 1, by="ann")
    accounts.tokens.revoke(first.row.id)
    assert accounts.tokens.add("t", "viewer", 1, by="ann").row.id != first.row.id


def test_guessed_tokens_are_rate_limited_and_a_valid_one_still_works(accounts):
    """Invalid tokens delay their address; a caller with a valid token is not delayed."""
    made = accounts.tokens.add("t", "viewer", 1, by="ann")
    for number in range(BY_TOKEN_ADDRESS.free):
        assert accounts.token_caller(f"gss_{number}", "a") is None
    with pytest.raises(RateLimited):
        accounts.token_caller("gss_one_more", "a")
    assert accounts.token_caller(made.key, "a") is not None


@pytest.mark.parametrize(
    ("name", "days"), [("", 1), ("x" * 51, 1), ("a\nb", 1), ("t", 0), ("t", 400), ("t", float("nan"))]
)
def test_a_token_has_a_name_and_an_end(accounts, name, days):
    """A token without a printable name or with an invalid lifetime is rejected."""
    with pytest.raises(BadInput):
        accounts.tokens.add(name, "viewer", days, by="ann")


def test_roles_have_distinct_permissions(accounts):
    """Every role includes viewer, and admin includes all permissions. Operator, manager and engineer each have a permission
    that the others lack."""
    assert all(ROLES["viewer"] <= role for role in ROLES.values())
    assert ROLES["admin"] == ALL
    middle = [ROLES[name] for name in ("operator", "catalogue manager", "engineer")]
    assert all(one - other for one in middle for other in middle if one is not other)
    assert not any(p.startswith("admin.") for role in middle for p in role)


def test_there_is_a_permission_for_each_group_of_the_dictionary():
    """Every subsystem of the dictionary's commands has a permission."""
    assert {f"command.{c.subsystem}" for c in load_dictionary().commands} <= set(COMMANDS)


def test_a_rejection_names_the_roles_that_have_the_permission():
    """A rejection states the permission and the roles that have it."""
    with pytest.raises(NotPermitted) as caught:
        require(ROLES["viewer"], "catalogues.build", "viewer")
    assert "catalogues.build" in caught.value.message
    assert caught.value.expected == "the role catalogue manager or admin"
    assert permitted(ROLES["engineer"], "command")
    assert not permitted(ROLES["viewer"], "command")
