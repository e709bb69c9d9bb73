"""Authority transfers: the row of the current holder stores the pending request or offer

The columns are empty in older rows.
"""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0014"
down_revision = "0013"
branch_labels = None
depends_on = None

COLUMNS = {
    "transfer": sa.String(length=10),
    "transfer_user": sa.String(length=60),
    "transfer_note": sa.Text(),
}


def upgrade() -> None:
    for name, kind in COLUMNS.items():
        op.add_column("authorities", sa.Column(name, kind, nullable=False, server_default=""))
    op.add_column("authorities", sa.Column("transfer_at", sa.DateTime(), nullable=True))


def downgrade() -> None:
    with op.batch_alter_table("authorities", schema=None) as batch_op:
        for name in (*COLUMNS, "transfer_at"):
            batch_op.drop_column(name)
