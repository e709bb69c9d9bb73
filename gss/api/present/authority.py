"""Command authority as a response."""

from __future__ import annotations

from gss.api.schemas.authority import AuthorityOut, AuthorityTransferOut, TenureOut
from gss.operations.commanding.authority import AuthorityState
from gss.store.models import Authority


def authority(state: AuthorityState, user: str | None = None) -> AuthorityOut:
    """Return the current holder and the history. ``user``: the caller, who may be the holder."""
    held = state.holder
    return AuthorityOut(
        holder=held.holder if held else None,
        since=held.taken if held else None,
        mine=held is not None and held.holder == user,
        transfer=None if held is None else _transfer(held),
        history=[TenureOut.model_validate(row) for row in state.history],
    )


def _transfer(row: Authority) -> AuthorityTransferOut | None:
    if not row.transfer:
        return None
    return AuthorityTransferOut.model_validate(
        {"kind": row.transfer, "user": row.transfer_user, "note": row.transfer_note, "at": row.transfer_at}
    )
