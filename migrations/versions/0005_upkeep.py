"""Upkeep: job checkpoints, frames without pixels"""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0005"
down_revision = "0004"
branch_labels = None
depends_on = None


def upgrade() -> None:
    with op.batch_alter_table("jobs", schema=None) as batch_op:
        batch_op.add_column(sa.Column("checkpoint", sa.JSON(none_as_null=True), nullable=True))
        batch_op.add_column(sa.Column("attempts", sa.Integer(), nullable=False, server_default="0"))
    with op.batch_alter_table("jobs", schema=None) as batch_op:
        batch_op.alter_column("attempts", server_default=None)

    with op.batch_alter_table("frames", schema=None) as batch_op:
        batch_op.add_column(sa.Column("pixels_removed", sa.DateTime(), nullable=True))
        batch_op.add_column(sa.Column("favourite", sa.Boolean(), nullable=False, server_default=sa.false()))
    with op.batch_alter_table("frames", schema=None) as batch_op:
        batch_op.alter_column("favourite", server_default=None)


def downgrade() -> None:
    with op.batch_alter_table("frames", schema=None) as batch_op:
        batch_op.drop_column("favourite")
        batch_op.drop_column("pixels_removed")

    with op.batch_alter_table("jobs", schema=None) as batch_op:
        batch_op.drop_column("attempts")
        batch_op.drop_column("checkpoint")
