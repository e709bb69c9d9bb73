"""Frames: size of the compressed pixels in the store

The column is null in older rows, whose pixels are not compressed.
"""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0012"
down_revision = "0011"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.add_column("frames", sa.Column("stored_bytes", sa.Integer(), nullable=True))


def downgrade() -> None:
    with op.batch_alter_table("frames", schema=None) as batch_op:
        batch_op.drop_column("stored_bytes")
