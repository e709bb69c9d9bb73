"""frames.time_known: false if an imported file states no time. Before, a frame that was taken at most five seconds before
or after its import counted as such a file."""

from __future__ import annotations

from datetime import timedelta

import sqlalchemy as sa
from alembic import op

revision = "0024"
down_revision = "0023"
branch_labels = None
depends_on = None

IMPORT = timedelta(seconds=5)


def upgrade() -> None:
    with op.batch_alter_table("frames") as batch:
        batch.add_column(sa.Column("time_known", sa.Boolean(), nullable=False, server_default=sa.true()))
    frames = sa.table(
        "frames",
        sa.column("id", sa.Integer),
        sa.column("source", sa.String),
        sa.column("taken", sa.DateTime(timezone=True)),
        sa.column("received", sa.DateTime(timezone=True)),
        sa.column("time_known", sa.Boolean),
    )
    connection = op.get_bind()
    imported = sa.select(frames.c.id, frames.c.taken, frames.c.received).where(frames.c.source == "import")
    unknown = [row.id for row in connection.execute(imported) if abs(row.received - row.taken) <= IMPORT]
    for frame_id in unknown:
        connection.execute(frames.update().where(frames.c.id == frame_id).values(time_known=False))


def downgrade() -> None:
    with op.batch_alter_table("frames") as batch:
        batch.drop_column("time_known")
