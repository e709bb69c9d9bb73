"""Users, sessions, API tokens and one-time links."""

from __future__ import annotations

import unicodedata
from datetime import datetime

from sqlalchemy import ColumnElement, exists, func, select, update
from sqlalchemy.exc import IntegrityError
from sqlalchemy.orm import Session

from gss.domain.errors import Conflict, NotFound
from gss.store.models import ApiToken, OneTimeLink, SignIn, User

# --- users --------------------------------------------------------------------------------------------------------


def any_user(session: Session) -> bool:
    """True if at least one user exists, with or without a password."""
    return bool(session.scalar(select(exists().where(User.id > 0))))


def users(session: Session) -> list[User]:
    """Return all users, sorted by name."""
    return list(session.scalars(select(User).order_by(User.name)))


def user(session: Session, user_id: int) -> User:
    """Return the user with that id. Raises NotFound if it does not exist."""
    row = session.get(User, user_id)
    if row is None:
        raise NotFound("no such user", got=str(user_id))
    return row


def user_named(session: Session, name: str) -> User | None:
    """Return the user with that name, ignoring case. The names are compared in Python, because SQLite ignores case for
    ASCII letters only."""
    key = name_key(name)
    matches = [row for row in users(session) if name_key(row.name) == key]
    return next((row for row in matches if row.name == name), matches[0] if matches else None)


def name_key(name: str) -> str:
    """Return the normalized form of a name. Two names with the same normalized form are treated as equal."""
    return unicodedata.normalize("NFKC", unicodedata.normalize("NFKC", name).casefold())


def add_user(session: Session, row: User) -> User:
    """Store a new user. Raises Conflict if the name exists, even if that user was created concurrently."""
    if user_named(session, row.name) is None:
        session.add(row)
        try:
            session.flush()
            return row
        except IntegrityError:
            pass
    raise Conflict("a user with this name exists", got=row.name, hint="choose another name")


def users_made_by(session: Session, creator: str, since: datetime, until: datetime) -> list[User]:
    """Return the enabled users that the user ``creator`` created in a time range."""
    conditions = (User.created_by == creator, User.created.between(since, until), User.enabled.is_(True))
    return list(session.scalars(select(User).where(*conditions).order_by(User.id)))


def enabled_admins(session: Session) -> int:
    """Return the number of enabled admins."""
    return session.scalar(select(func.count()).where(User.role == "admin", User.enabled.is_(True))) or 0


# --- sessions -----------------------------------------------------------------------------------------------------


def sign_in_of(session: Session, key_hash: str) -> tuple[SignIn, User] | None:
    """Return the session with that key and its user."""
    row = session.execute(select(SignIn, User).join(User).where(SignIn.key_hash == key_hash)).first()
    return None if row is None else (row[0], row[1])


def sign_in(session: Session, sign_in_id: int) -> tuple[SignIn, User]:
    """Return the session with that id and its user. Raises NotFound if it does not exist."""
    row = session.execute(select(SignIn, User).join(User).where(SignIn.id == sign_in_id)).first()
    if row is None:
        raise NotFound("no such session", got=str(sign_in_id))
    return row[0], row[1]


def open_sign_ins(session: Session, now: datetime) -> list[tuple[SignIn, User]]:
    """Return the open sessions and their users, most recently used first."""
    query = select(SignIn, User).join(User).where(SignIn.ended.is_(None), SignIn.expires > now)
    return [(row[0], row[1]) for row in session.execute(query.order_by(SignIn.last_seen.desc()))]


def record_sign_in(session: Session, user_id: int, password_hash: str, now: datetime) -> User | None:
    """Store the time of a sign-in and return the user. None if the user is disabled or has another password hash now."""
    criteria = (User.id == user_id, User.enabled, User.password_hash == password_hash)
    signed_in = session.execute(update(User).where(*criteria).values(last_sign_in=now).returning(User.id)).scalar()
    return None if signed_in is None else user(session, signed_in)


def replace_hash(session: Session, user_id: int, old_hash: str, new_hash: str) -> bool:
    """Replace a password hash. Return False if the user has another hash now."""
    criteria = (User.id == user_id, User.password_hash == old_hash)
    replaced = update(User).where(*criteria).values(password_hash=new_hash).returning(User.id)
    return session.execute(replaced).scalar() is not None


def end_sign_ins(session: Session, user_id: int, now: datetime, reason: str) -> None:
    """End every session of a user."""
    criteria = (SignIn.user_id == user_id, SignIn.ended.is_(None))
    session.execute(update(SignIn).where(*criteria).values(ended=now, end_reason=reason))


def seen(session: Session, sign_in_id: int, at: datetime) -> None:
    """Record the time of the latest request with this session."""
    session.execute(update(SignIn).where(SignIn.id == sign_in_id).values(last_seen=at))


def used(session: Session, token_id: int, at: datetime) -> None:
    """Record the time of the latest request with this token."""
    session.execute(update(ApiToken).where(ApiToken.id == token_id).values(last_used=at))


def user_of_device(session: Session, device_hash: str, since: datetime) -> int | None:
    """Return the id of the user who signed in with that device cookie at or after ``since``; None if there is none."""
    criteria = (SignIn.device_hash == device_hash, SignIn.created >= since)
    return session.scalar(select(SignIn.user_id).where(*criteria).limit(1))


# --- tokens -------------------------------------------------------------------------------------------------------


def token_of(session: Session, key_hash: str) -> tuple[ApiToken, User | None] | None:
    """Return the token with that key, and its creator."""
    query = select(ApiToken, User).outerjoin(User, ApiToken.owner_id == User.id)
    row = session.execute(query.where(ApiToken.key_hash == key_hash)).first()
    return None if row is None else (row[0], row[1])


def token(session: Session, token_id: int) -> tuple[ApiToken, User | None]:
    """Return the token with that id, and its creator. Raises NotFound if it does not exist."""
    query = select(ApiToken, User).outerjoin(User, ApiToken.owner_id == User.id)
    row = session.execute(query.where(ApiToken.id == token_id)).first()
    if row is None:
        raise NotFound("no such token", got=str(token_id))
    return row[0], row[1]


def tokens(session: Session) -> list[ApiToken]:
    """Return all tokens, newest first."""
    return list(session.scalars(select(ApiToken).order_by(ApiToken.id.desc())))


def tokens_made_by(session: Session, creator: str, since: datetime, until: datetime) -> list[ApiToken]:
    """Return the unrevoked tokens that the user ``creator`` created in a time range."""
    conditions = (ApiToken.created_by == creator, ApiToken.created.between(since, until), ApiToken.revoked.is_(None))
    return list(session.scalars(select(ApiToken).where(*conditions)))


def tokens_owned_by(session: Session, user_id: int) -> list[ApiToken]:
    """Return all tokens that a user created, including expired and revoked tokens."""
    return list(session.scalars(select(ApiToken).where(ApiToken.owner_id == user_id)))


def living_token(session: Session, name: str, now: datetime) -> tuple[ApiToken, User | None] | None:
    """Return the valid token with that name, and its creator; None if there is none."""
    query = select(ApiToken, User).outerjoin(User, ApiToken.owner_id == User.id)
    criteria = (ApiToken.name == name, ApiToken.revoked.is_(None), ApiToken.expires > now)
    row = session.execute(query.where(*criteria).order_by(ApiToken.id.desc())).first()
    return None if row is None else (row[0], row[1])


# --- one-time links -----------------------------------------------------------------------------------------------


def add_link(session: Session, row: OneTimeLink) -> None:
    """Store a new one-time link."""
    session.add(row)
    session.flush()


def void_links_made_by(session: Session, creator: str, since: datetime, until: datetime) -> int:
    """Invalidate the unused links that the user ``creator`` created in a time range. Return the number of
    links."""
    conditions = (
        OneTimeLink.created_by == creator,
        OneTimeLink.created.between(since, until),
        OneTimeLink.used.is_(None),
    )
    return len(
        session.execute(update(OneTimeLink).where(*conditions).values(used=until).returning(OneTimeLink.id)).all()
    )


def void_links(session: Session, kind: str, user_id: int | None, now: datetime) -> None:
    """Invalidate all unused links of that kind and user."""
    unused = (OneTimeLink.kind == kind, OneTimeLink.user_id == user_id, OneTimeLink.used.is_(None))
    session.execute(update(OneTimeLink).where(*unused).values(used=now))


def fresh_link(session: Session, kind: str, key_hash: str, now: datetime) -> OneTimeLink | None:
    """Return the link with that key if it is still valid, else None."""
    return session.scalar(select(OneTimeLink).where(*_valid_link(kind, key_hash, now)))


def take_link(session: Session, kind: str, key_hash: str, now: datetime) -> OneTimeLink | None:
    """Mark a link as used and return it. The update is atomic, so only one of two concurrent requests receives the
    link. None if the link is used, expired or unknown."""
    mark_used = update(OneTimeLink).where(*_valid_link(kind, key_hash, now)).values(used=now).returning(OneTimeLink.id)
    link_id = session.execute(mark_used).scalar()
    return None if link_id is None else session.get(OneTimeLink, link_id)


def _valid_link(kind: str, key_hash: str, now: datetime) -> tuple[ColumnElement[bool], ...]:
    criteria = (OneTimeLink.kind == kind, OneTimeLink.key_hash == key_hash)
    return (*criteria, OneTimeLink.used.is_(None), OneTimeLink.expires > now)
