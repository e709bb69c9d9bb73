"""Alembic's entry point. All migrations run online in one transaction. In SQLite, tables are altered by copying them
(batch)."""

from __future__ import annotations

from typing import Any

from alembic import context

from gss.store.migration import open_for_migration
from gss.store.models import Base, UtcDateTime


def render_item(kind: str, item: Any, _context: Any) -> str | bool:
    """Render a column type of GSS as its underlying SQLAlchemy type, because a migration must not depend on current
    code."""
    return "sa.DateTime()" if kind == "type" and isinstance(item, UtcDateTime) else False


engine = open_for_migration(context.config.get_main_option("sqlalchemy.url") or "")
with engine.connect() as connection:
    context.configure(
        connection=connection,
        target_metadata=Base.metadata,
        render_as_batch=True,
        render_item=render_item,
        transactional_ddl=True,
    )
    with context.begin_transaction():
        context.run_migrations()
engine.dispose()
