"""Command authority as a response."""

from __future__ import annotations

from gss.api.schemas.authority import AuthorityOut, TenureOut
from gss.operations.commanding.authority import AuthorityState


def authority(state: AuthorityState, user: str | None = None) -> AuthorityOut:
    """Return the current holder and the history. ``user``: the caller, who may be the holder."""
    held = state.holder
    return AuthorityOut(
        holder=held.holder if held else None,
        since=held.taken if held else None,
        mine=held is not None and held.holder == user,
        history=[TenureOut.model_validate(row) for row in state.history],
    )
