"""API tokens, for admins."""

from __future__ import annotations

from gss.api.api_router import api_router
from gss.api.deps import App, AuditNote, CurrentUser, RowId, need
from gss.api.schemas.accounts import NewTokenOut, TokenIn, TokenOut

router = api_router("tokens", "/tokens")
ADMIN = need("admin.tokens")


@router.get("", dependencies=[ADMIN])
def list_tokens(app: App) -> list[TokenOut]:
    """API tokens, newest first, including expired and revoked tokens."""
    return [TokenOut.model_validate(row) for row in app.accounts.accounts.tokens.list_all()]


@router.post("", status_code=201, dependencies=[ADMIN])
def add_token(app: App, caller: CurrentUser, body: TokenIn, audit_note: AuditNote) -> NewTokenOut:
    """Create an API token. The key is shown only once. A token cannot have more permissions than its creator."""
    only = f", only {', '.join(body.scopes)}" if body.scopes else ""
    audit_note(f"{body.name} as {body.role} for {body.days:g} days{only}")
    caller.require_all(body.role, body.scopes)
    new_token = app.accounts.accounts.tokens.add(
        body.name,
        body.role,
        body.days,
        by=caller.name,
        owner_id=caller.user_id,
        scopes=body.scopes,
        until=caller.handed_out_until,
    )
    return NewTokenOut(token=TokenOut.model_validate(new_token.row), key=new_token.key)


@router.delete("/{token_id}", status_code=204, dependencies=[ADMIN])
def revoke_token(app: App, token_id: RowId, caller: CurrentUser, audit_note: AuditNote) -> None:
    """Revoke an API token with immediate effect. Tokens and links created with it become invalid, and users created
    with it are disabled."""
    revoked = app.accounts.accounts.tokens.revoke(token_id, caller_id=caller.user_id)
    audit_note(revoked.row.name, revoked.voided)
