"""Links and users created by a token or admin that is revoked, demoted or disabled become invalid and are disabled."""

from __future__ import annotations

import pytest

from gss.domain.errors import Conflict, NotPermitted, NotSignedIn
from gss.operations.accounts.accounts import AccountService
from gss.operations.accounts.passwords import Passwords

PASSWORD = "correct horse battery"


@pytest.fixture
def accounts(database, clock) -> AccountService:
    """Account service with two admins, ann and eve."""
    service = AccountService(database, clock, lambda: clock.at.timestamp(), Passwords(1, 8, 1))
    service.users.add("ann", "admin", by="shell:root", password=PASSWORD)
    service.users.add("eve", "admin", by="shell:root", password=PASSWORD)
    return service


def is_rejected(accounts: AccountService, key: str) -> bool:
    """True if the password link is invalid."""
    try:
        accounts.users.set_password_by_link(key, "another good password")
    except NotPermitted:
        return True
    return False


def test_revoking_a_token_disables_its_users_and_links(accounts, clock):
    """When a token is revoked, its links and the users that it created, directly or indirectly, are disabled. Links and
    users of others and of a later token with this name are not."""
    ann = accounts.users.named("ann")
    token = accounts.tokens.add("setup", "admin", 9, by="ann", owner_id=ann.id)
    clock.forward(60)
    mallory = accounts.users.add("mallory", "admin", by="token:setup", password=PASSWORD)
    backdoor = accounts.users.add("backdoor", "viewer", by="mallory", password=PASSWORD)
    honest = accounts.users.add("honest", "viewer", by="ann", password=PASSWORD)
    opened = accounts.sessions.sign_in("backdoor", PASSWORD, address="a")
    link = accounts.users.password_link(honest.id, by="token:setup")
    other = accounts.users.password_link(accounts.users.named("eve").id, by="ann")
    revoked = accounts.tokens.revoke(token.row.id)
    assert (revoked.voided.users, revoked.voided.links) == (("mallory", "backdoor"), 1)
    assert str(revoked.voided) == "also disabled: mallory, backdoor; links invalidated: 1"
    assert is_rejected(accounts, link.key)
    assert not is_rejected(accounts, other.key)
    assert accounts.session_caller(opened.key) is None
    for name in ("mallory", "backdoor"):
        with pytest.raises(NotSignedIn):
            accounts.sessions.sign_in(name, PASSWORD, address="b")
    assert accounts.users.get(mallory.id).disabled_reason == "created by token:setup, which was revoked"
    assert accounts.users.get(backdoor.id).disabled_reason == "created by mallory, who was disabled"
    clock.forward(60)
    accounts.tokens.add("setup", "admin", 9, by="ann", owner_id=ann.id)
    accounts.users.add("later", "viewer", by="token:setup")
    accounts.tokens.revoke(token.row.id)
    assert accounts.users.named("later").enabled


@pytest.mark.parametrize("change", [{"role": "viewer"}, {"enabled": False}])
def test_demoting_an_admin_disables_created_users_and_links(accounts, change):
    """When an admin is demoted or disabled, links and users created in a session or with a token are disabled, except the
    caller. An admin can enable each again."""
    eve, ann = accounts.users.named("eve"), accounts.users.named("ann")
    accounts.tokens.add("hers", "admin", 9, by="eve", owner_id=eve.id)
    by_session = accounts.users.add("by hand", "viewer", by="eve")
    accounts.users.add("by token", "viewer", by="token:hers")
    caller = accounts.users.add("caller", "admin", by="eve")
    link = accounts.users.password_link(by_session.id, by="eve")
    anns = accounts.users.password_link(ann.id, by="token:hers")
    changed = accounts.users.change(eve.id, **change, caller_id=caller.id)
    assert changed.voided.users == ("by hand", "by token")
    assert is_rejected(accounts, link.key)
    assert is_rejected(accounts, anns.key)
    reason = "is no longer an admin" if "role" in change else "was disabled"
    assert accounts.users.named("by token").disabled_reason == f"created by eve, who {reason}"
    assert accounts.users.named("caller").enabled
    enabled_again = accounts.users.change(by_session.id, enabled=True).user
    assert (enabled_again.enabled, enabled_again.disabled_reason) == (True, "")


def test_created_users_can_be_kept_and_the_last_admin_stays(accounts):
    """Users created by a disabled admin can be kept. The last admin cannot be disabled."""
    eve, ann = accounts.users.named("eve"), accounts.users.named("ann")
    kept = accounts.users.add("kept", "operator", by="eve")
    accounts.users.change(eve.id, enabled=False, keep_created=True)
    assert accounts.users.get(kept.id).enabled
    accounts.users.add("second", "admin", by="ann")
    with pytest.raises(Conflict, match="last admin"):
        accounts.users.change(ann.id, enabled=False)
    assert accounts.users.named("second").enabled
