"""Instrument versions: frames, contacts and catalogues store the version of their instrument package

The columns are null in older rows, whose version is unknown.
"""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0009"
down_revision = "0008"
branch_labels = None
depends_on = None

TABLES = ("frames", "contacts", "catalogues")


def upgrade() -> None:
    op.add_column("contacts", sa.Column("instrument", sa.String(length=40), nullable=True))
    for table in TABLES:
        op.add_column(table, sa.Column("instrument_version", sa.String(length=64), nullable=True))


def downgrade() -> None:
    for table in TABLES:
        with op.batch_alter_table(table, schema=None) as batch_op:
            batch_op.drop_column("instrument_version")
    with op.batch_alter_table("contacts", schema=None) as batch_op:
        batch_op.drop_column("instrument")
