"""Ids of telemetry packets and procedures are not used again. SQLite needs AUTOINCREMENT for this; PostgreSQL has sequences."""

from __future__ import annotations

from alembic import op

revision = "0029"
down_revision = "0028"
branch_labels = None
depends_on = None

TABLES = ("telemetry_packets", "procedures")


def upgrade() -> None:
    _copy(sqlite_autoincrement=True)


def downgrade() -> None:
    _copy()


def _copy(**options: bool) -> None:
    """Copy the tables on SQLite."""
    if op.get_bind().dialect.name == "sqlite":
        for name in TABLES:
            with op.batch_alter_table(name, recreate="always", table_kwargs=options):
                pass
