"""Unit for which each command was queued"""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0030"
down_revision = "0029"
branch_labels = None
depends_on = None


def upgrade() -> None:
    with op.batch_alter_table("commands") as table:
        table.add_column(sa.Column("unit", sa.String(length=80), nullable=False, server_default=""))
    with op.batch_alter_table("commands") as table:
        table.alter_column("unit", server_default=None)


def downgrade() -> None:
    with op.batch_alter_table("commands") as table:
        table.drop_column("unit")
