"""Sign-in: sessions, rate limits and passwords, with cheap hashing and manual clocks."""

from __future__ import annotations

from collections.abc import Iterator
from datetime import timedelta

import pytest

from gss.domain.errors import BadInput, Conflict, NotPermitted, NotSignedIn, RateLimited, StoreDown
from gss.operations.accounts.accounts import REMEMBERED_S, AccountService
from gss.operations.accounts.attempts import BY_NAME
from gss.operations.accounts.passwords import Passwords
from gss.operations.accounts.sign_in import Lifetimes
from gss.store.models import OneTimeLink, SignIn, User

PASSWORD = "correct horse battery"
LIVES = Lifetimes(timedelta(hours=1), timedelta(hours=10))


class Seconds:
    """Monotonic clock that advances only when a test advances it."""

    def __init__(self) -> None:
        self.at_s = 1000.0

    def __call__(self) -> float:
        return self.at_s


@pytest.fixture
def seconds() -> Seconds:
    """Clock of rate limits and caches."""
    return Seconds()


@pytest.fixture
def accounts(database, clock, seconds) -> Iterator[AccountService]:
    """Account service with an admin, ann, and an operator, ben."""
    service = AccountService(database, clock, seconds, Passwords(1, 8, 1), LIVES)
    service.users.add("ann", "admin", by="shell", password=PASSWORD)
    service.users.add("ben", "operator", by="ann", password=PASSWORD + " ben")
    return service


def sign_in(accounts: AccountService, name: str = "ann", password: str = PASSWORD, address: str = "a", **more: str):
    return accounts.sessions.sign_in(name, password, address=address, **more)


def test_a_session_is_known_by_its_key_and_stored_as_a_hash(accounts, database):
    """The cookie's key identifies name, role and permissions; no column contains the key or the password."""
    opened = sign_in(accounts)
    who = accounts.session_caller(opened.key)
    assert (who.name, who.role, who.may("admin.users")) == ("ann", "admin", True)
    with database.unit_of_work() as session:
        stored = [str(vars(row)) for kind in (User, SignIn) for row in session.query(kind)]
    assert not any(opened.key in text or PASSWORD in text for text in stored)
    assert accounts.session_caller(opened.key + "x") is None


def test_a_session_key_from_before_sign_in_is_invalid_after_it(accounts):
    """Session fixation: each sign-in creates a new key and invalidates the browser's previous key."""
    first = sign_in(accounts)
    second = sign_in(accounts, old_key=first.key)
    assert first.key != second.key
    assert accounts.session_caller(first.key) is None
    assert accounts.session_caller(second.key) is not None


def test_a_session_ends_when_idle_and_at_its_maximum_age(accounts, clock, seconds):
    """A session ends after one hour without a request, and after ten hours in any case."""
    idle, busy = sign_in(accounts).key, sign_in(accounts).key
    for _ in range(18):
        clock.forward(1900)
        seconds.at_s += 1900
        assert accounts.session_caller(busy) is not None
    assert accounts.session_caller(idle) is None
    clock.forward(1900)
    seconds.at_s += 1900
    assert accounts.session_caller(busy) is None


def test_an_open_page_does_not_extend_a_session_but_is_notified_of_its_end(accounts, clock):
    """``ended_reason`` returns the reason and does not count as a request."""
    who = sign_in(accounts).caller
    assert accounts.ended_reason(who) == ""
    clock.forward(3601)
    assert "idle timeout" in accounts.ended_reason(who)


def test_requesting_the_session_lifetime_does_not_extend_it(accounts, clock, seconds):
    """Only real requests reset the idle timeout; the earlier of the two ends is returned."""
    opened = sign_in(accounts)
    assert opened.caller.expires == clock.at + LIVES.idle
    clock.forward(3500)
    seconds.at_s += 3500
    assert accounts.session_caller(opened.key, touch=False).expires == opened.caller.expires
    clock.forward(100)
    seconds.at_s += 100
    assert accounts.session_caller(opened.key, touch=False) is None


def test_users_stay_authenticated_with_a_full_disk_or_an_unreadable_database(accounts, database, clock, seconds):
    """With a full disk, sessions are valid. While the database is unreadable, a session stays valid for ten minutes, so
    that ABORT works. Unknown callers are rejected.
    """
    opened = sign_in(accounts)
    clock.forward(120)
    seconds.at_s += 120
    with database.engine.connect() as pooled:
        pooled.exec_driver_sql("PRAGMA query_only=ON")  # as on a full disk: reads succeed, writes fail
    with pytest.raises(StoreDown):
        accounts.users.change(opened.caller.user_id, role="viewer")
    assert accounts.session_caller(opened.key).role == "admin"
    accounts.sessions._database = Unreadable()
    seconds.at_s += 300
    assert accounts.session_caller(opened.key).name == "ann"
    with pytest.raises(StoreDown):
        accounts.session_caller("another key")
    seconds.at_s += 301
    with pytest.raises(StoreDown):
        accounts.session_caller(opened.key)


class Unreadable:
    """Database whose disk has failed."""

    def unit_of_work(self):
        raise StoreDown("the database cannot be used")


def test_a_new_password_ends_all_sessions_of_that_user(accounts):
    """Sessions on other computers end immediately; sessions of other users continue."""
    mine, elsewhere, other = (
        sign_in(accounts),
        sign_in(accounts, address="b"),
        sign_in(accounts, "ben", PASSWORD + " ben"),
    )
    accounts.users.set_password(mine.caller.user_id, "another good password")
    assert accounts.session_caller(mine.key) is None
    assert accounts.ended_reason(elsewhere.caller) == "the password was changed"
    assert accounts.session_caller(other.key) is not None
    with pytest.raises(NotSignedIn):
        sign_in(accounts)
    assert sign_in(accounts, password="another good password").caller.name == "ann"


def test_disabling_a_user_takes_effect_immediately(accounts):
    """When a user is disabled, the session ends, and sign-in and running work are rejected."""
    opened = sign_in(accounts, "ben", PASSWORD + " ben")
    accounts.require("ben", "command.imager")
    accounts.users.change(opened.caller.user_id, enabled=False)
    assert accounts.session_caller(opened.key) is None
    with pytest.raises(NotSignedIn):
        sign_in(accounts, "ben", PASSWORD + " ben")
    with pytest.raises(NotPermitted):
        accounts.require("ben", "command.imager")


def test_the_last_admin_cannot_be_lost(accounts):
    """The last admin can be neither disabled nor given another role; with a second admin both are possible."""
    ann, ben = accounts.users.named("ann"), accounts.users.named("ben")
    for change in ({"enabled": False}, {"role": "viewer"}):
        with pytest.raises(Conflict, match="last admin"):
            accounts.users.change(ann.id, **change)
    accounts.users.change(ben.id, role="admin")
    assert accounts.users.change(ann.id, role="viewer", caller_id=ben.id).user.role == "viewer"


def test_another_role_applies_from_the_next_request_on(accounts):
    """A changed role applies to an open session from the next request on, without a new sign-in."""
    opened = sign_in(accounts, "ben", PASSWORD + " ben")
    assert accounts.session_caller(opened.key).may("command.link")
    accounts.users.change(opened.caller.user_id, role="viewer")
    assert not accounts.session_caller(opened.key).may("command.link")


def test_a_lookup_that_overlaps_a_change_is_not_cached(accounts, monkeypatch):
    """The result of a lookup that was read before a concurrent change is used for that request only."""
    key, ben = sign_in(accounts, "ben", PASSWORD + " ben").key, accounts.users.named("ben")
    read = accounts.sessions.caller_of

    def overtaken(*args, **more):
        who = read(*args, **more)
        accounts.users.change(ben.id, role="viewer")
        return who

    with monkeypatch.context() as patch:
        patch.setattr(accounts.sessions, "caller_of", overtaken)
        assert accounts.session_caller(key).role == "operator"
    assert accounts.remembered("session", key) is None
    assert accounts.session_caller(key).role == "viewer"


def test_a_session_ended_by_another_process_is_rejected_within_the_cache_time(accounts, database, clock, seconds):
    """After a second server process disables the user, the first process accepts the session for at most one second."""
    other = AccountService(database, clock, seconds, Passwords(1, 8, 1), LIVES)
    opened = sign_in(accounts, "ben", PASSWORD + " ben")
    assert accounts.session_caller(opened.key) is not None
    other.users.change(opened.caller.user_id, enabled=False)
    seconds.at_s += REMEMBERED_S
    assert accounts.session_caller(opened.key) is None


def test_an_unknown_name_costs_the_same_hashing_as_a_known_one(accounts):
    """Neither the time nor the text of the response reveals whether a name exists."""
    answers = []
    for name in ("ann", "unknown-user"):
        before = accounts.passwords.verified
        with pytest.raises(NotSignedIn) as caught:
            sign_in(accounts, name, "wrong password")
        answers.append((accounts.passwords.verified - before, str(caught.value)))
    assert answers[0] == answers[1]
    assert answers[0][0] == 1


def test_guessing_becomes_slower_with_each_failure(accounts, seconds):
    """The delay doubles after five failures up to its limit, so 60 guesses take more than 20 minutes."""
    tries, began_s = 0, seconds.at_s
    while tries < 60:
        try:
            sign_in(accounts, password=f"wrong {tries}")
        except NotSignedIn:
            tries += 1
        except RateLimited as wait:
            seconds.at_s += wait.retry_after_s
    assert seconds.at_s - began_s > 40 * 30


def test_guesses_from_many_addresses_do_not_lock_the_admin_out(accounts, seconds):
    """Failures with ann's name at 200 addresses do not delay her in a browser in which she signed in before."""
    device = sign_in(accounts, address="desk").device
    for number in range(200):
        with pytest.raises((NotSignedIn, RateLimited)):
            sign_in(accounts, password="wrong", address=f"10.0.0.{number}")
    with pytest.raises(RateLimited):
        sign_in(accounts, address="desk")
    assert sign_in(accounts, address="desk", device=device).caller.name == "ann"
    seconds.at_s += 31
    assert sign_in(accounts, address="an address she never used").caller.name == "ann"


def test_responses_do_not_reveal_names_used_at_an_address(accounts):
    """Without ann's device cookie, attempts with her name and with an unknown name get the same responses and delays, also
    at the address where she signed in and with the cookie of another user."""
    sign_in(accounts, address="desk")
    bens = sign_in(accounts, "ben", PASSWORD + " ben", address="desk").device

    def answers(name: str, device: str) -> list[str]:
        accounts.attempts._failures.clear()
        errors = []
        for attempt in range(25):
            try:
                sign_in(accounts, name if attempt % 3 else f"other {attempt}", "wrong", address="desk", device=device)
            except (NotSignedIn, RateLimited) as error:
                errors.append(repr((type(error), str(error), getattr(error, "retry_after_s", None))))
        return errors

    assert len(answers("ann", "")) == 25
    assert answers("ann", "") == answers("no such user", "")
    assert answers("ann", bens) == answers("no such user", bens)


def test_a_device_cookie_has_a_limit_of_guesses(accounts):
    """Guesses with a valid device cookie are limited, so a stolen one does not bypass the limit."""
    device = sign_in(accounts).device
    for _ in range(BY_NAME.free):
        with pytest.raises(NotSignedIn):
            sign_in(accounts, password="wrong", device=device)
    with pytest.raises(RateLimited):
        sign_in(accounts, password="wrong", device=device)


def test_ones_own_sign_in_does_not_reset_the_limit_for_other_accounts(accounts):
    """A successful sign-in between guesses does not reset the rate limit of the address."""

    def alternate() -> None:
        for guess in range(100):
            sign_in(accounts, "ben", PASSWORD + " ben", address="inside")
            with pytest.raises(NotSignedIn):
                sign_in(accounts, f"other {guess}", "wrong", address="inside")

    with pytest.raises(RateLimited):
        alternate()


def test_concurrent_attempts_count_before_they_fail(accounts):
    """The rate limit counts attempts when they start, so that simultaneous guesses are limited too."""
    keys = [("name ann", BY_NAME)]
    for _ in range(BY_NAME.free):
        accounts.attempts.begin(keys)
    with pytest.raises(RateLimited):
        accounts.attempts.begin(keys)


@pytest.mark.parametrize(
    "password",
    [
        "short",
        "",
        "x" * 201,
        "aaaaaaaaaaaaaaaa",
        "password123",
        "Startracker",
        "benedict99",
        "99tcideneb",
        "P@ssw0rd2026!!",
        "Benedict-2026",
        "1234509876",
        "qwertzuiop!",
        "abcabcabcabcabc",
        "asdfghjklöä",
        "Groundstation1!",
    ],
)
def test_common_passwords_are_rejected_without_repeating_them(password):
    """Passwords that are too short, too long, common or similar to the name are rejected. The message does not contain the
    password."""
    with pytest.raises(BadInput) as caught:
        Passwords.check_new(password, "benedict99")
    assert not password or password not in str(caught.value)


@pytest.mark.parametrize(
    "password", ["a fine new password", "vega over the hills", "Jt7#kqZw2m", "admin of the moon", "ééèüöäßñçå"]
)
def test_other_passwords_are_accepted(password):
    """Other passwords are accepted, also if a common word is part of them."""
    Passwords.check_new(password, "benedict99")


def test_a_password_with_a_cheap_hash_is_rehashed_at_sign_in(database, clock, seconds):
    """A higher hashing cost applies to every user at the next sign-in."""
    AccountService(database, clock, seconds, Passwords(1, 8, 1)).users.add("ann", "admin", by="x", password=PASSWORD)
    dearer = AccountService(database, clock, seconds, Passwords(2, 16, 1))
    sign_in(dearer)
    assert "m=16,t=2,p=1" in dearer.users.named("ann").password_hash
    assert dearer.users.named("ann").password_hash.startswith("$argon2id$")


class InterruptedPasswords(Passwords):
    """Passwords with a function that runs once, after the next verification."""

    def __init__(self, passes: int, memory_kib: int) -> None:
        super().__init__(passes, memory_kib, 1)
        self.then = lambda: None

    def verify(self, stored: str, password: str) -> bool:
        is_correct, then, self.then = super().verify(stored, password), self.then, lambda: None
        then()
        return is_correct


@pytest.mark.parametrize("memory_kib", [8, 16])
def test_a_sign_in_in_progress_does_not_survive_a_password_change(accounts, database, clock, seconds, memory_kib):
    """A sign-in whose password is changed during the verification fails, and does not restore the hash of the old
    password. The same applies to a user who is disabled meanwhile.
    """
    passwords = InterruptedPasswords(1, memory_kib)
    interrupted = AccountService(database, clock, seconds, passwords, LIVES)
    ben_id, old, new = accounts.users.named("ben").id, PASSWORD + " ben", "vega above the hills"
    for password, change in (
        (old, lambda: accounts.users.set_password(ben_id, new)),
        (new, lambda: accounts.users.change(ben_id, enabled=False)),
    ):
        passwords.then = change
        with pytest.raises(NotSignedIn, match="wrong name or password"):
            sign_in(interrupted, "ben", password)
        accounts.users.change(ben_id, enabled=True)
        assert accounts.sessions.active() == []
    with pytest.raises(NotSignedIn):
        sign_in(interrupted, "ben", old)
    assert sign_in(interrupted, "ben", new).caller.name == "ben"


def test_a_password_change_in_progress_does_not_replace_a_newer_password(accounts, database, clock, seconds):
    """If an admin's password link sets another password while the old one is verified, the change of the user is rejected."""
    passwords = InterruptedPasswords(1, 8)
    interrupted = AccountService(database, clock, seconds, passwords, LIVES)
    caller, new = sign_in(interrupted).caller, "vega above the hills"
    passwords.then = lambda: accounts.users.set_password(caller.user_id, new)
    verified_hash = interrupted.sessions.check_password(caller, PASSWORD)
    with pytest.raises(NotPermitted, match="changed meanwhile"):
        interrupted.users.set_password(caller.user_id, "altair over the sea", verified_hash)
    assert sign_in(interrupted, password=new).caller.name == "ann"


def test_two_sign_ins_at_once_can_both_replace_a_cheap_hash(accounts, database, clock, seconds):
    """A user whose hash is replaced by another sign-in at the same time is signed in."""
    passwords = InterruptedPasswords(2, 16)
    interrupted = AccountService(database, clock, seconds, passwords, LIVES)
    passwords.then = lambda: sign_in(interrupted)
    first = sign_in(interrupted)
    assert len(accounts.sessions.active()) == 2
    assert accounts.session_caller(first.key).name == "ann"


def test_two_spellings_of_one_name_are_one_user(accounts):
    """Names that look equal on a page cannot both be created. Names of software are reserved."""
    with pytest.raises(Conflict):
        accounts.users.add("Ann", "viewer", by="ann")
    for name in ("token:x", "GSS", "server"):
        with pytest.raises(BadInput, match="reserved"):
            accounts.users.add(name, "viewer", by="ann")


def test_there_is_no_default_account(database, clock, seconds):
    """An empty server accepts no name and password."""
    empty = AccountService(database, clock, seconds, Passwords(1, 8, 1))
    assert empty.users.set_up_needed()
    for name in ("admin", "root", "gss", "operator-1"):
        for password in ("", "admin", "password", name):
            with pytest.raises((NotSignedIn, RateLimited)):
                sign_in(empty, name, password, address=name + password)


def test_the_setup_link_works_once_and_creates_the_first_admin(database, clock, seconds):
    """The setup link creates the first admin once. A newer link replaces it, guesses fail, and it is stored as a hash."""
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


def test_links_expire(database, clock, seconds, accounts):
    """A password link expires after a day, works once, and is not created for a disabled user."""
    ben = accounts.users.named("ben")
    link = accounts.users.password_link(ben.id, by="test")
    clock.forward(24 * 3600)
    with pytest.raises(NotPermitted):
        accounts.users.set_password_by_link(link.key, "a fine new password")
    link = accounts.users.password_link(ben.id, by="test")
    assert accounts.users.set_password_by_link(link.key, "a fine new password").name == "ben"
    with pytest.raises(NotPermitted):
        accounts.users.set_password_by_link(link.key, "a second new password")
    accounts.users.change(ben.id, enabled=False)
    with pytest.raises(Conflict):
        accounts.users.password_link(ben.id, by="test")


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
def test_a_name_is_printable_and_not_reserved(accounts, name):
    """A name with invisible characters or double spaces, or a reserved one, is rejected."""
    with pytest.raises(BadInput):
        accounts.users.add(name, "viewer", by="ann")


@pytest.mark.parametrize("name", ["\u0430nn", "b\u0435n", "o\u03c1erator"])
def test_a_name_has_letters_of_one_script(accounts, name):
    """A name with a Cyrillic or Greek letter among Latin ones is rejected, because it cannot be distinguished."""
    with pytest.raises(BadInput, match="mixes scripts"):
        accounts.users.add(name, "viewer", by="ann")


@pytest.mark.parametrize(
    ("first", "second"),
    [("\u0441\u0430\u0440\u0430", "capa"), ("paul", "pau1"), ("lan", "Ian"), ("emie", "ernie"), ("zoe", "z0e")],
)
def test_a_name_that_looks_like_another_is_rejected(accounts, first, second):
    """A name that looks like an existing one is rejected. A name that differs visibly is accepted."""
    accounts.users.add(first, "viewer", by="ann")
    with pytest.raises(Conflict, match="looks like"):
        accounts.users.add(second, "viewer", by="ann")
    accounts.users.add(f"{second} Smith", "viewer", by="ann")


def test_a_name_is_unique_in_any_case(accounts):
    """Names that differ only in case or in compatible forms of the same letters are rejected, also beyond ASCII."""
    user = accounts.users.add("\uff25\u0301va Ünal", "viewer", by="ann")
    assert user.name == "Éva Ünal"
    for name in ("éva ünal", "ÉVA ÜNAL", "E\u0301va U\u0308nal", "\uff21nn"):
        with pytest.raises(Conflict):
            accounts.users.add(name, "viewer", by="ann")


def test_a_known_browser_is_not_delayed_by_failures_from_the_same_address(accounts):
    """Failed sign-ins under other names do not delay a user whose browser signed in before."""
    device = sign_in(accounts).device
    for number in range(20):
        with pytest.raises((NotSignedIn, RateLimited)):
            sign_in(accounts, f"stranger {number}", "wrong")
    with pytest.raises(RateLimited):
        sign_in(accounts, "ben", PASSWORD + " ben")
    assert sign_in(accounts, device=device).caller.name == "ann"
