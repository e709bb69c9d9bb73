"""Command authority as a response."""

from __future__ import annotations

from gss.api.schemas.authority import AuthorityOut, AuthorityTransferOut, TenureOut
from gss.operations.commanding.authority import AuthorityState
from gss.store.models import Authority


def authority(state: AuthorityState, user: str | None = None) -> AuthorityOut:
    """Return the current holder and the history. ``user``: the caller, for the field ``mine``."""
    tenure = state.holder
    return AuthorityOut(
        holder=tenure.holder if tenure else None,
        since=tenure.taken if tenure else None,
        mine=tenure is not None and tenure.holder == user,
        transfer=None if tenure is None else _transfer(tenure),
        history=[TenureOut.model_validate(row) for row in state.history],
    )


def _transfer(row: Authority) -> AuthorityTransferOut | None:
    if not row.transfer:
        return None
    return AuthorityTransferOut.model_validate(
        {"kind": row.transfer, "user": row.transfer_user, "note": row.transfer_note, "at": row.transfer_at}
    )
