"""Signing in: sessions, brakes, passwords. Cheap hashing, clocks turned by hand."""

from __future__ import annotations

from collections.abc import Iterator
from datetime import timedelta

import pytest

from gss.domain.errors import BadInput, Conflict, NotPermitted, NotSignedIn, StoreDown, TooOften
from gss.operations.accounts.accounts import REMEMBERED_S, AccountService
from gss.operations.accounts.attempts import BY_NAME
from gss.operations.accounts.passwords import Passwords
from gss.operations.accounts.sign_in import Lifetimes
from gss.store.models import OneTimeLink, SignIn, User

PASSWORD = "correct horse battery"
LIVES = Lifetimes(timedelta(hours=1), timedelta(hours=10))


class Seconds:
    """A monotonic clock that only moves when told."""

    def __init__(self) -> None:
        self.at_s = 1000.0

    def __call__(self) -> float:
        return self.at_s


@pytest.fixture
def seconds() -> Seconds:
    """The clock of brakes and memory."""
    return Seconds()


@pytest.fixture
def accounts(database, clock, seconds) -> Iterator[AccountService]:
    """With one admin, ann, and an operator, ben."""
    service = AccountService(database, clock, seconds, Passwords(1, 8, 1), LIVES)
    service.users.add("ann", "admin", by="shell", password=PASSWORD)
    service.users.add("ben", "operator", by="ann", password=PASSWORD + " ben")
    return service


def sign_in(accounts: AccountService, name: str = "ann", password: str = PASSWORD, address: str = "a", **more: str):
    return accounts.sessions.sign_in(name, password, address=address, **more)


def test_a_session_is_known_by_its_key_and_stored_as_a_hash(accounts, database):
    """The cookie's key finds name, role and permissions; no column holds the key or the password."""
    opened = sign_in(accounts)
    who = accounts.who_has_cookie(opened.key)
    assert (who.name, who.role, who.may("admin.users")) == ("ann", "admin", True)
    with database.unit_of_work() as session:
        stored = [str(vars(row)) for kind in (User, SignIn) for row in session.query(kind)]
    assert not any(opened.key in text or PASSWORD in text for text in stored)
    assert accounts.who_has_cookie(opened.key + "x") is None


def test_the_key_before_signing_in_is_worth_nothing_after_it(accounts):
    """Session fixation: each sign-in makes a new key and ends the one that the browser had."""
    first = sign_in(accounts)
    second = sign_in(accounts, old_key=first.key)
    assert first.key != second.key
    assert accounts.who_has_cookie(first.key) is None
    assert accounts.who_has_cookie(second.key) is not None


def test_a_session_ends_after_idling_and_after_its_longest_time(accounts, clock, seconds):
    """An hour without a request, or ten hours with."""
    idle, busy = sign_in(accounts).key, sign_in(accounts).key
    for _ in range(18):
        clock.forward(1900)
        seconds.at_s += 1900
        assert accounts.who_has_cookie(busy) is not None
    assert accounts.who_has_cookie(idle) is None
    clock.forward(1900)
    seconds.at_s += 1900
    assert accounts.who_has_cookie(busy) is None


def test_an_open_page_does_not_keep_a_session_alive_but_learns_of_its_end(accounts, clock):
    """``why_over`` says why, and is no request."""
    who = sign_in(accounts).who
    assert accounts.why_over(who) == ""
    clock.forward(3601)
    assert "too long" in accounts.why_over(who)


def test_asking_how_long_a_session_lasts_does_not_make_it_longer(accounts, clock, seconds):
    """Only real requests count against idling; the end that is told is the nearer one."""
    opened = sign_in(accounts)
    assert opened.who.expires == clock.at + LIVES.idle
    clock.forward(3500)
    seconds.at_s += 3500
    assert accounts.who_has_cookie(opened.key, touch=False).expires == opened.who.expires
    clock.forward(100)
    seconds.at_s += 100
    assert accounts.who_has_cookie(opened.key, touch=False) is None


def test_a_full_disk_keeps_nobody_out_and_an_unreadable_database_not_for_long(accounts, database, clock, seconds):
    """ABORT must get through: who was known ten minutes ago still is while the database cannot be read; a stranger is not."""
    opened = sign_in(accounts)
    clock.forward(120)
    seconds.at_s += 120
    with database.engine.connect() as pooled:
        pooled.exec_driver_sql("PRAGMA query_only=ON")  # as on a full disk: reading goes on, writing does not
    with pytest.raises(StoreDown):
        accounts.users.change(opened.who.user_id, role="viewer")
    assert accounts.who_has_cookie(opened.key).role == "admin"
    accounts.sessions._database = Unreadable()
    seconds.at_s += 300
    assert accounts.who_has_cookie(opened.key).name == "ann"
    with pytest.raises(StoreDown):
        accounts.who_has_cookie("somebody else")
    seconds.at_s += 301
    with pytest.raises(StoreDown):
        accounts.who_has_cookie(opened.key)


class Unreadable:
    """A database whose disk is gone."""

    def unit_of_work(self):
        raise StoreDown("the database cannot be used now")


def test_a_new_password_ends_all_sessions_of_that_user(accounts):
    """Also those elsewhere, at once; another's go on."""
    mine, elsewhere, other = (
        sign_in(accounts),
        sign_in(accounts, address="b"),
        sign_in(accounts, "ben", PASSWORD + " ben"),
    )
    accounts.users.set_password(mine.who.user_id, "another good password")
    assert accounts.who_has_cookie(mine.key) is None
    assert accounts.why_over(elsewhere.who) == "the password was changed"
    assert accounts.who_has_cookie(other.key) is not None
    with pytest.raises(NotSignedIn):
        sign_in(accounts)
    assert sign_in(accounts, password="another good password").who.name == "ann"


def test_switching_a_user_off_ends_everything_at_once(accounts):
    """The session, signing in again, and what goes on under the name."""
    opened = sign_in(accounts, "ben", PASSWORD + " ben")
    accounts.require("ben", "command.imager")
    accounts.users.change(opened.who.user_id, enabled=False)
    assert accounts.who_has_cookie(opened.key) is None
    with pytest.raises(NotSignedIn):
        sign_in(accounts, "ben", PASSWORD + " ben")
    with pytest.raises(NotPermitted):
        accounts.require("ben", "command.imager")


def test_the_last_admin_cannot_be_lost(accounts):
    """Neither switched off nor made something else; with a second one it can."""
    ann, ben = accounts.users.named("ann"), accounts.users.named("ben")
    for change in ({"enabled": False}, {"role": "viewer"}):
        with pytest.raises(Conflict, match="last admin"):
            accounts.users.change(ann.id, **change)
    accounts.users.change(ben.id, role="admin")
    assert accounts.users.change(ann.id, role="viewer").role == "viewer"


def test_another_role_holds_from_the_next_request_on(accounts):
    """Nobody has to sign in again for less or for more."""
    opened = sign_in(accounts, "ben", PASSWORD + " ben")
    assert accounts.who_has_cookie(opened.key).may("command.link")
    accounts.users.change(opened.who.user_id, role="viewer")
    assert not accounts.who_has_cookie(opened.key).may("command.link")


def test_an_answer_that_was_on_its_way_during_a_change_is_not_remembered(accounts, monkeypatch):
    """Read before the change and given after it, it holds for that one request only."""
    key, ben = sign_in(accounts, "ben", PASSWORD + " ben").key, accounts.users.named("ben")
    read = accounts.sessions.who

    def overtaken(*args, **more):
        who = read(*args, **more)
        accounts.users.change(ben.id, role="viewer")
        return who

    with monkeypatch.context() as patch:
        patch.setattr(accounts.sessions, "who", overtaken)
        assert accounts.who_has_cookie(key).role == "operator"
    assert accounts.remembered("session", key) is None
    assert accounts.who_has_cookie(key).role == "viewer"


def test_what_another_process_ended_is_seen_within_the_memory(accounts, database, clock, seconds):
    """A second server process switches the user off; the first one takes its word for at most a second."""
    other = AccountService(database, clock, seconds, Passwords(1, 8, 1), LIVES)
    opened = sign_in(accounts, "ben", PASSWORD + " ben")
    assert accounts.who_has_cookie(opened.key) is not None
    other.users.change(opened.who.user_id, enabled=False)
    seconds.at_s += REMEMBERED_S
    assert accounts.who_has_cookie(opened.key) is None


def test_an_unknown_name_costs_the_same_hashing_as_a_known_one(accounts):
    """Whether a name exists cannot be told by the time or the words of the answer."""
    answers = []
    for name in ("ann", "nobody-here"):
        before = accounts.passwords.verified
        with pytest.raises(NotSignedIn) as caught:
            sign_in(accounts, name, "wrong password")
        answers.append((accounts.passwords.verified - before, str(caught.value)))
    assert answers[0] == answers[1]
    assert answers[0][0] == 1


def test_guessing_gets_slower_and_slower(accounts, seconds):
    """Ten thousand guesses from one address would take days: after five failures the wait doubles to its limit."""
    tries, began_s = 0, seconds.at_s
    while tries < 60:
        try:
            sign_in(accounts, password=f"wrong {tries}")
        except NotSignedIn:
            tries += 1
        except TooOften as wait:
            seconds.at_s += wait.retry_after_s
    assert seconds.at_s - began_s > 40 * 30


def test_guessers_from_everywhere_do_not_lock_the_admin_out(accounts, seconds):
    """Ann signed in from her desk before: thousands of failures under her name elsewhere do not make her wait there."""
    sign_in(accounts, address="desk")
    for number in range(200):
        with pytest.raises((NotSignedIn, TooOften)):
            sign_in(accounts, password="wrong", address=f"10.0.0.{number}")
    with pytest.raises(TooOften):
        sign_in(accounts, address="an address she never used")
    assert sign_in(accounts, address="desk").who.name == "ann"
    seconds.at_s += 31
    assert sign_in(accounts, address="an address she never used").who.name == "ann"


def test_ones_own_account_is_no_key_to_others(accounts):
    """Signing in oneself between guesses does not take the address's brake off."""

    def alternate() -> None:
        for guess in range(100):
            sign_in(accounts, "ben", PASSWORD + " ben", address="inside")
            with pytest.raises(NotSignedIn):
                sign_in(accounts, f"other {guess}", "wrong", address="inside")

    with pytest.raises(TooOften):
        alternate()


def test_tries_at_the_same_time_count_before_they_have_failed(accounts):
    """The brake counts beginnings: a hundred guesses at once are not a hundred free ones."""
    keys = [("name ann", BY_NAME)]
    for _ in range(BY_NAME.free):
        accounts.attempts.begin(keys)
    with pytest.raises(TooOften):
        accounts.attempts.begin(keys)


@pytest.mark.parametrize(
    "password", ["short", "", "x" * 201, "aaaaaaaaaaaaaaaa", "password123", "Startracker", "benedict99", "99tcideneb"]
)
def test_passwords_that_are_guessed_first_are_refused_without_repeating_them(password):
    """Too short, too long, usual, or the name; the message never holds the password."""
    with pytest.raises(BadInput) as caught:
        Passwords.check_new(password, "benedict99")
    assert not password or password not in str(caught.value)


def test_a_password_hashed_cheaply_is_hashed_anew_at_sign_in(database, clock, seconds):
    """Raising the cost reaches everybody who comes back."""
    AccountService(database, clock, seconds, Passwords(1, 8, 1)).users.add("ann", "admin", by="x", password=PASSWORD)
    dearer = AccountService(database, clock, seconds, Passwords(2, 16, 1))
    sign_in(dearer)
    assert "m=16,t=2,p=1" in dearer.users.named("ann").password_hash
    assert dearer.users.named("ann").password_hash.startswith("$argon2id$")


def test_two_spellings_of_one_name_are_one_user(accounts):
    """Ann cannot be told from ann on a page; neither can she be made twice. Names of software are nobody's."""
    with pytest.raises(Conflict):
        accounts.users.add("Ann", "viewer", by="ann")
    for name in ("token:x", "GSS", "server"):
        with pytest.raises(BadInput, match="software"):
            accounts.users.add(name, "viewer", by="ann")


def test_there_is_no_default_account(database, clock, seconds):
    """An empty server knows nobody, whatever the name and password."""
    empty = AccountService(database, clock, seconds, Passwords(1, 8, 1))
    assert empty.users.set_up_needed()
    for name in ("admin", "root", "gss", "operator-1"):
        for password in ("", "admin", "password", name):
            with pytest.raises((NotSignedIn, TooOften)):
                sign_in(empty, name, password, address=name + password)


def test_the_set_up_link_works_once_and_makes_the_first_admin(database, clock, seconds):
    """A newer link replaces it, time ends it, guesses do not fit, and with the first user it is over."""
    users = AccountService(database, clock, seconds, Passwords(1, 8, 1)).users
    old, link = users.set_up_link(), users.set_up_link()
    for key in (old.key, "guess", "", link.key + "x"):
        with pytest.raises(NotPermitted):
            users.set_up(key, "ann", PASSWORD)
    with pytest.raises(BadInput):
        users.set_up(link.key, "ann", "short")
    assert users.set_up(link.key, "ann", PASSWORD).role == "admin"
    with pytest.raises(NotPermitted):
        users.set_up(link.key, "eve", PASSWORD)
    assert users.set_up_link() is None
    with database.unit_of_work() as session:
        assert all(link.key not in str(vars(row)) for row in session.query(OneTimeLink))


def test_links_end_with_their_time(database, clock, seconds, accounts):
    """A password link after a day; a set-up link after an hour."""
    ben = accounts.users.named("ben")
    link = accounts.users.password_link(ben.id)
    clock.forward(24 * 3600)
    with pytest.raises(NotPermitted):
        accounts.users.set_password_by_link(link.key, "a fine new password")
    link = accounts.users.password_link(ben.id)
    assert accounts.users.set_password_by_link(link.key, "a fine new password").name == "ben"
    with pytest.raises(NotPermitted):
        accounts.users.set_password_by_link(link.key, "a second new password")
    accounts.users.change(ben.id, enabled=False)
    with pytest.raises(Conflict):
        accounts.users.password_link(ben.id)


@pytest.mark.parametrize(
    "name",
    [
        "an\u200bn",
        "ann\u3164",
        "ann\u2800",
        "ann\ufe0f",
        "\u202eann",
        "a  b",
        "GSS",
        "Server",
        "shell:ann",
        "token\uff1aann",
        "Set-up link",
        "unknown name",
    ],
)
def test_a_name_shows_and_is_not_that_of_software(accounts, name):
    """Nobody is on the record under a name that looks like another's or the server's own."""
    with pytest.raises(BadInput):
        accounts.users.add(name, "viewer", by="ann")


def test_a_name_is_unique_in_any_case(accounts):
    """Also beyond ASCII, and in compatible forms of the same letters."""
    made = accounts.users.add("\uff25\u0301va Ünal", "viewer", by="ann")
    assert made.name == "Éva Ünal"
    for name in ("éva ünal", "ÉVA ÜNAL", "E\u0301va U\u0308nal", "\uff21nn"):
        with pytest.raises(Conflict):
            accounts.users.add(name, "viewer", by="ann")


def test_who_is_known_from_an_address_does_not_wait_for_strangers_there(accounts):
    """Behind one address many may sit: guesses at other names keep no user out who signed in from there before."""
    sign_in(accounts)
    for number in range(20):
        with pytest.raises((NotSignedIn, TooOften)):
            sign_in(accounts, f"stranger {number}", "wrong")
    with pytest.raises(TooOften):
        sign_in(accounts, "ben", PASSWORD + " ben")
    assert sign_in(accounts).who.name == "ann"
