"""Creator of a one-time link, reason why a user was disabled, and the cookie that identifies a browser at sign-in"""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0008"
down_revision = "0007"
branch_labels = None
depends_on = None

COLUMNS = (("users", "disabled_reason", 200), ("one_time_links", "created_by", 60), ("sign_ins", "device_hash", 64))


def upgrade() -> None:
    for table, name, length in COLUMNS:
        op.add_column(table, sa.Column(name, sa.String(length=length), nullable=False, server_default=""))
    op.create_index("ix_sign_ins_device_hash", "sign_ins", ["device_hash"])


def downgrade() -> None:
    op.drop_index("ix_sign_ins_device_hash", "sign_ins")
    for table, name, _ in COLUMNS:
        with op.batch_alter_table(table, schema=None) as batch_op:
            batch_op.drop_column(name)
