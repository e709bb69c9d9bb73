"""Command authority as a response."""

from __future__ import annotations

from gss.api.schemas.authority import AuthorityOut, AuthorityTransferOut, TenureOut
from gss.operations.commanding.authority import AuthorityState
from gss.store.models import Authority


def authority(state: AuthorityState, user: str | None = None) -> AuthorityOut:
    """Return the current holder and the history. ``user``: the caller, who may be the holder."""
    holding = state.holder
    return AuthorityOut(
        holder=holding.holder if holding else None,
        since=holding.taken if holding else None,
        mine=holding is not None and holding.holder == user,
        transfer=None if holding is None else _transfer(holding),
        history=[TenureOut.model_validate(row) for row in state.history],
    )


def _transfer(row: Authority) -> AuthorityTransferOut | None:
    if not row.transfer:
        return None
    return AuthorityTransferOut.model_validate(
        {"kind": row.transfer, "user": row.transfer_user, "note": row.transfer_note, "at": row.transfer_at}
    )
